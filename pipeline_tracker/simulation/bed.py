"""The bed: a height field that goes with the pipe, and stones on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.jit import compiled
from pipeline_tracker.simulation.axis import PipeAxis, Wander
from pipeline_tracker.simulation.extra import trimesh_module
from pipeline_tracker.simulation.meshes import Mesh, grid_faces
from pipeline_tracker.simulation.noise import fractal_noise, gradient_noise
from pipeline_tracker.simulation.scenario import BedModel

Array = NDArray[np.float64]

# Beside the pipe the bed follows it; from this far away on it has its own relief, m.
_BLEND = 2.0
_MOST_CELLS = 12_000_000


@dataclass(frozen=True)
class Bounds:
    """A rectangle in the world seen from above, m."""

    x0: float
    x1: float
    y0: float
    y1: float

    @property
    def area(self) -> float:
        """Its area, m²."""
        return (self.x1 - self.x0) * (self.y1 - self.y0)


@dataclass(frozen=True)
class Bed:
    """The height field.

    Attributes:
        x0, y0: place of the first vertex, m.
        resolution: spacing, m.
        heights: (X, Y), m.
    """

    x0: float
    y0: float
    resolution: float
    heights: Array

    @classmethod
    def draw(
        cls,
        model: BedModel,
        axis: PipeAxis,
        bounds: Bounds,
        rng: np.random.Generator,
        *,
        level_beside: bool = True,
    ) -> Bed:
        """Draw a bed.

        Args:
            model: the bed's model.
            axis: the pipe that lies in it.
            bounds: what it has to cover.
            rng: random numbers.
            level_beside: the large undulations fade towards the axis, as where a pipe lies.

        Raises:
            SettingsError: the resolution asks for more vertices than fit in memory.
        """
        step = model.resolution
        x = np.arange(bounds.x0, bounds.x1 + step, step)
        y = np.arange(bounds.y0, bounds.y1 + step, step)
        if x.size * y.size > _MOST_CELLS:
            raise SettingsError(
                f"bed.resolution = {step:g} gives {x.size * y.size} vertices on "
                f"{bounds.area:.0f} m², expected at most {_MOST_CELLS}; choose a coarser one or "
                "fewer frames"
            )
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        s, side = axis.nearest(places)
        burial = model.burial + Wander.draw(rng, model.burial_variation, 5.0)(s)
        height = axis.points(s)[..., 2] + axis.radius * (2.0 * burial - 1.0)
        away = np.clip((np.abs(side) - axis.radius) / _BLEND, 0.0, 1.0)
        away = away * away * (3.0 - 2.0 * away) if level_beside else np.ones_like(away)
        seed = int(rng.integers(1 << 30))
        detail = _relief(
            x,
            y,
            away,
            np.array([model.relief, model.roughness, model.ripple_height]),
            np.array([model.relief_length, model.ripple_length]),
            step,
            seed,
        )
        for drift in model.drifts:
            along = ((s - drift.at) / drift.length) ** 2
            across = ((side - drift.offset) / drift.width) ** 2
            # Its border wavers with the small relief, as that of any heap does.
            detail += drift.height * np.exp(-0.5 * (along + across) + 3.0 * detail)
        return cls(float(x[0]), float(y[0]), step, height + detail)

    def height_at(self, places: Array) -> Array:
        """Return heights (N,) at places (N, 2 or 3), m; beyond the border the border's."""
        at = (np.asarray(places)[..., :2] - np.array([self.x0, self.y0])) / self.resolution
        coordinates = np.moveaxis(at, -1, 0)
        value: Array = map_coordinates(self.heights, coordinates, order=1, mode="nearest")
        return value

    def mesh(self) -> Mesh:
        """Return its triangles."""
        rows, columns = self.heights.shape
        vertices = np.empty((rows, columns, 3), np.float32)
        vertices[..., 0] = (self.x0 + self.resolution * np.arange(rows))[:, None]
        vertices[..., 1] = self.y0 + self.resolution * np.arange(columns)
        vertices[..., 2] = self.heights
        return Mesh(vertices.reshape(-1, 3), grid_faces(rows, columns))

    def slopes(self) -> NDArray[np.float32]:
        """Return the slopes by x and y at each vertex, (X, Y, 2)."""
        by_x, by_y = np.gradient(self.heights, self.resolution)
        return np.stack((by_x, by_y), axis=-1).astype(np.float32)


@compiled
def _relief(
    x: Array, y: Array, away: Array, height: Array, length: Array, step: float, seed: int
) -> Array:
    """Add up undulations (relief, roughness) and ripples; (X, Y), m."""
    result = np.empty((x.size, y.size))
    for i in range(x.size):
        for j in range(y.size):
            px, py = x[i], y[j]
            large = fractal_noise(px, py, length[0], 3, 0.5, step, 0, seed)[0]
            small = fractal_noise(px, py, 0.6, 4, 0.55, step, 0, seed + 1)[0]
            # Ripples in patches, their crests bent by noise.
            patch = gradient_noise(px / 1.9, py / 1.9, 0, seed + 2)[0] * 2.0 + 0.3
            patch = min(1.0, max(0.0, patch))
            bent = gradient_noise(px / 0.8, py / 0.8, 0, seed + 3)[0]
            bent += 2.0 * gradient_noise(px / 2.5, py / 2.5, 0, seed + 4)[0]
            phase = (0.8 * px + 0.6 * py) / length[1] + 0.6 * bent
            crest = 1.0 - 2.0 * abs(np.sin(np.pi * phase))
            result[i, j] = (
                2.5 * height[0] * away[i, j] * large
                + 2.5 * height[1] * small
                + 0.5 * height[2] * patch * crest
            )
    return result


@dataclass(frozen=True)
class Stones:
    """All stones in one mesh.

    Attributes:
        mesh: their triangles.
        normals: (V, 3) float32, unit.
        brightness: (V,) float32, of the stone that a vertex belongs to, about 1.
    """

    mesh: Mesh
    normals: NDArray[np.float32]
    brightness: NDArray[np.float32]


def scatter_stones(
    model: BedModel, pipe: PipeAxis | None, bed: Bed, bounds: Bounds, rng: np.random.Generator
) -> Stones:
    """Scatter stones over the bed, beside the pipe where there is one, not in it."""
    trimesh = trimesh_module()
    count = int(rng.poisson(model.stones * bounds.area))
    places = rng.uniform([bounds.x0, bounds.y0], [bounds.x1, bounds.y1], (count, 2))
    sizes = np.clip(model.stone_size * np.exp(0.55 * rng.standard_normal(count)), 0.01, 1.0)
    side = pipe.nearest(places)[1] if pipe and count else np.full(count, np.inf)
    radius = pipe.radius if pipe else 0.0
    ground = bed.height_at(places) if count else np.zeros(0)
    ball: Any = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces, brightness = [np.zeros((0, 3))], [np.zeros((0, 3), int)], [np.zeros(0)]
    total = 0
    for place, size, z, away in zip(places, sizes, ground, np.abs(side), strict=True):
        shape = lump(np.asarray(ball.vertices), size, rng)
        if away < radius + 0.8 * size:
            continue
        vertices.append(shape + np.array([*place, z + 0.15 * size]))
        faces.append(np.asarray(ball.faces) + total)
        brightness.append(np.full(len(shape), rng.uniform(0.5, 1.15)))
        total += len(shape)
    solid: Any = trimesh.Trimesh(np.vstack(vertices), np.vstack(faces), process=False)
    normals = np.asarray(solid.vertex_normals) if total else np.zeros((0, 3))
    mesh = Mesh(np.vstack(vertices).astype(np.float32), np.vstack(faces).astype(np.int32))
    return Stones(mesh, normals.astype(np.float32), np.concatenate(brightness).astype(np.float32))


def lump(ball: Array, size: float, rng: np.random.Generator) -> Array:
    """Deform a unit ball (V, 3) to a stone or a lump of about the given size, m; (V, 3)."""
    bumps = np.zeros(len(ball))
    for strength, frequency in ((0.16, 1.6), (0.10, 3.0), (0.05, 6.0)):
        wave = rng.standard_normal(3) * frequency
        bumps += strength * np.sin(ball @ wave + rng.uniform(0.0, 2.0 * np.pi))
    stretch = np.array([1.0, rng.uniform(0.6, 0.95), rng.uniform(0.4, 0.75)])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    shape = 0.5 * size * (1.0 + bumps)[:, None] * ball * stretch
    turned: Array = shape @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned
