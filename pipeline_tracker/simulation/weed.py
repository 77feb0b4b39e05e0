"""Weed and soft growth: tufts of blades and lumps, on the pipe and on the bed.

Each metre of pipe and each square metre of bed has its own random numbers, so that what grows there
does not depend on how much of the sea is made.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.bed import Bed, Bounds, lump
from pipeline_tracker.simulation.extra import trimesh_module
from pipeline_tracker.simulation.meshes import grid_faces
from pipeline_tracker.simulation.object_models import WeedModel
from pipeline_tracker.simulation.pieces import Piece, smooth_normals
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.streams import random_stream

Array = NDArray[np.float64]

# Blades of a tuft, and places along a blade.
_BLADES, _KNOTS = 26, 5
# Area that a clump hides from above, in squares of its height.
_AREA = 0.5
# Growth reaches this far down the pipe's sides from its top, rad.
_LOWEST = np.deg2rad(105.0)
# Numbers of metres and square metres are counted from here, as streams know none below 0.
_FIRST = 1 << 20
_UP = np.array([0.0, 0.0, 1.0])


def weeds(
    scenario: Scenario, axis: PipeAxis, bed: Bed, bounds: Bounds, material: int
) -> Iterator[Piece]:
    """Grow a scenario's weed.

    Args:
        scenario: for its weed and its seed.
        axis: the pipe.
        bed: the bed.
        bounds: what of the bed there is.
        material: number of the material of tufts; the next one is that of lumps.
    """
    model = scenario.weed
    if scenario.pipe.present and model.pipe_share > 0.0:
        for n in range(int(np.floor(axis.start)), int(np.ceil(axis.end))):
            yield from _on_pipe(
                model, axis, n, random_stream(scenario, "weed", _FIRST + n), material
            )
    if model.on_bed > 0.0:
        for x in range(int(np.floor(bounds.x0)), int(np.ceil(bounds.x1))):
            for y in range(int(np.floor(bounds.y0)), int(np.ceil(bounds.y1))):
                rng = random_stream(scenario, "bed weed", _FIRST + x, _FIRST + y)
                places = rng.uniform([x, y], [x + 1, y + 1], (rng.poisson(model.on_bed), 2))
                for place, z in zip(places, bed.height_at(places), strict=True):
                    root = np.array([*place, z])
                    yield _clump(model, root, _UP, rng, material)


def _on_pipe(
    model: WeedModel, axis: PipeAxis, metre: int, rng: np.random.Generator, material: int
) -> Iterator[Piece]:
    """Grow one metre of pipe over."""
    # Clumps fall anywhere, also on one another.
    side = 2.0 * _LOWEST * axis.radius
    mean = -np.log1p(-model.pipe_share) * side / (_AREA * model.height**2)
    # Thick here, thin there.
    count = rng.poisson(mean * rng.gamma(2.5, 1.0 / 2.5))
    s = metre + rng.uniform(0.0, 1.0, count)
    _, right, up = axis.frames(s)
    angle = rng.uniform(-_LOWEST, _LOWEST, count)[:, None]
    normals = np.cos(angle) * up + np.sin(angle) * right
    for root, normal in zip(axis.points(s) + axis.radius * normals, normals, strict=True):
        yield _clump(model, root, normal, rng, material)


def _clump(
    model: WeedModel, root: Array, normal: Array, rng: np.random.Generator, material: int
) -> Piece:
    height = model.height * float(np.exp(0.35 * rng.standard_normal()))
    if rng.uniform() < model.lumps:
        return _lump(root, 0.8 * height, rng, material + 1)
    return _tuft(root, normal, height, rng, material)


def _tuft(
    root: Array, normal: Array, height: float, rng: np.random.Generator, material: int
) -> Piece:
    """Return blades that spread from a root, rise and bend with the water.

    Its first coordinate is 0 at the root and 1 at the tips, its second tells blades apart.
    """
    # Weed floats up, wherever it grows.
    stem = normal + 0.7 * _UP
    away = 0.55 * rng.standard_normal((_BLADES, 3))
    first = stem / np.linalg.norm(stem) + away
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    # The current bends all of a place one way.
    lean = np.array([0.5, 0.35, -0.25]) + 0.4 * rng.standard_normal((_BLADES, 3))
    length = height * rng.uniform(0.5, 1.25, _BLADES)[:, None, None]
    t = np.linspace(0.0, 1.0, _KNOTS)[None, :, None]
    middle = length * (t * first[:, None] + 0.6 * t**2 * lean[:, None])
    start = 0.12 * height * rng.standard_normal((_BLADES, 1, 3))
    start -= np.sum(start * normal, axis=-1, keepdims=True) * normal
    flat = np.cross(first, rng.standard_normal((_BLADES, 3)))
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    width = 0.055 * height * rng.uniform(0.6, 1.6, (_BLADES, 1, 1)) * (1.0 - 0.85 * t**2)
    edge = width * flat[:, None]
    # Two edges of each blade: (blades, knots, 2, 3).
    places = root + start[:, :, None] + np.stack([middle - edge, middle + edge], axis=2)
    along = first[:, None] + 1.2 * t * lean[:, None]
    normals = np.cross(along, flat[:, None])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    shade = rng.uniform(0.0, 1.0, (_BLADES, 1, 1))
    coordinates = np.stack(np.broadcast_arrays(t + 0 * shade, shade + 0 * t), axis=-1)
    one = grid_faces(_KNOTS, 2)
    faces = (one[None] + 2 * _KNOTS * np.arange(_BLADES)[:, None, None]).reshape(-1, 3)
    return Piece(
        places.reshape(-1, 3),
        faces.astype(np.int32),
        np.repeat(normals[:, :, None], 2, axis=2).reshape(-1, 3),
        np.repeat(coordinates, 2, axis=2).reshape(-1, 2),
        material,
        thin=True,
    )


def _lump(root: Array, size: float, rng: np.random.Generator, material: int) -> Piece:
    """Return a soft lump, a sponge or a cushion; its coordinates are those of a map of it."""
    ball: Any = trimesh_module().creation.icosphere(subdivisions=2)
    unit, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.int32)
    vertices = lump(unit, size, rng)
    normals = smooth_normals(vertices, faces, np.zeros(3))
    normals *= np.where(np.sum(normals * vertices, axis=1) < 0.0, -1.0, 1.0)[:, None]
    seed = rng.uniform(0.0, 100.0)
    coordinates = size * np.stack([unit[:, 0] + 0.5 * unit[:, 2], unit[:, 1]], axis=1) + seed
    return Piece(vertices + root, faces, normals, coordinates, material)
