"""Marine snow: particles that drift between camera and scene and shine in the lamps' light.

Near ones are out of focus and large, far ones points. Both images of a pair are taken at once, so
that both show the same particles, each with the disparity of its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.simulation.lens import Lens, lenses_of
from pipeline_tracker.simulation.light import Lamps, Water, arriving
from pipeline_tracker.simulation.scenario import Scenario

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

# Particles farther away than this are fainter than the noise and part of the haze, m.
_NEAREST, _FARTHEST = 0.12, 4.0
# Share of light that a particle returns, and the camera's aperture, m.
_ALBEDO, _APERTURE = 0.25, 0.008
# A disc is never smaller than this, px, and its border twice as wide: no particle falls between
# pixels.
_SMALLEST = 0.6


class Snow(NamedTuple):
    """Particles in the left camera's optical frame.

    Attributes:
        places: (N, 3), m.
        sizes: (N,), m, diameters.
    """

    places: Array
    sizes: Array


def draw_snow(scenario: Scenario, rng: np.random.Generator) -> Snow:
    """Draw the particles of one moment, evenly spread over the water before both cameras."""
    camera, water = scenario.camera, scenario.water
    # Half the width and height of what either camera sees at a depth of 1 m, and the margin for
    # the right camera and for large discs at the border.
    spread = np.max([_widest(lens) for lens in lenses_of(camera)], axis=0)
    margin = np.array([camera.baseline, 0.0]) + 0.05

    def area(depth: Array | float) -> Array:
        section: Array = np.prod(2.0 * (np.multiply.outer(depth, spread) + margin), axis=-1)
        return section

    # Even in depth and thinned to the cross section: even in space.
    widest = float(area(_FARTHEST))
    count = rng.poisson(water.snow * widest * (_FARTHEST - _NEAREST))
    depth = rng.uniform(_NEAREST, _FARTHEST, count)
    depth = depth[rng.uniform(0.0, widest, count) < area(depth)]
    reach = np.multiply.outer(depth, spread) + margin
    across = rng.uniform(-1.0, 1.0, reach.shape) * reach
    sizes = water.snow_size * np.exp(0.5 * rng.standard_normal(len(depth)))
    return Snow(np.column_stack([across, depth]), sizes)


def _widest(lens: Lens) -> Array:
    """Return how far to the side and up or down a camera sees at a depth of 1 m, (2,)."""
    width, height = lens.camera.width, lens.camera.height
    x, y = (np.linspace(-0.5, size - 0.5, 9) for size in (width, height))
    rays = lens.rays(np.stack(np.meshgrid(x, y), axis=-1))
    widest: Array = np.abs(rays[..., :2] / rays[..., 2:]).max(axis=(0, 1))
    return widest


@dataclass(frozen=True)
class SnowView:
    """What is the same for all snow before one camera.

    Attributes:
        lens: the camera.
        lamps: in the left camera's frame.
        water: what the light passes.
        focus: depth at which particles are sharp, m.
    """

    lens: Lens
    lamps: Lamps
    water: Water
    focus: float

    @classmethod
    def of(cls, scenario: Scenario, lamps: Lamps, water: Water, index: int) -> SnowView:
        """Prepare camera ``index`` of a scenario; lamps in base_link."""
        lens = lenses_of(scenario.camera)[index]
        mounted = scenario.camera.mounting().inverse()
        return cls(lens, lamps.moved(mounted), water, scenario.path.distance)

    def over(self, light: Float32Array, distance: Float32Array, snow: Snow) -> Float32Array:
        """Return the image with the snow before it.

        Args:
            light: (H, W, 3), red, green, blue.
            distance: (H, W), m, along the rays: what lies nearer hides a particle.
            snow: the particles.
        """
        result = light.copy()
        centre = self.lens.camera.centre
        order = np.argsort(-snow.places[:, 2], kind="stable")
        places, sizes = snow.places[order], snow.sizes[order]
        _splat(
            result,
            distance,
            _Discs(places, self.lens.project(places - centre), sizes),
            _Optics(centre, float(self.lens.matrix[0, 0]), self.focus),
            self.lamps,
            self.water,
        )
        return result


class _Discs(NamedTuple):
    """Particles in drawing order: places (left camera's frame), pixels of their middles, sizes."""

    places: Array
    pixels: Array
    sizes: Array


class _Optics(NamedTuple):
    """A camera's centre (left camera's frame, m), focal length (px) and depth of focus (m)."""

    centre: Array
    focal: float
    focus: float


@compiled
def _splat(
    light: Float32Array,
    distance: Float32Array,
    discs: _Discs,
    optics: _Optics,
    lamps: Lamps,
    water: Water,
) -> None:
    """Draw particles into ``light``."""
    height, width = distance.shape
    places, pixels, sizes = discs
    centre, focal, focus = optics
    shine = np.empty(3)
    for n in range(sizes.size):
        u, v, z = pixels[n, 0], pixels[n, 1], places[n, 2]
        away = np.sqrt((places[n, 0] - centre[0]) ** 2 + places[n, 1] ** 2 + z * z)
        # Radius of the particle's own picture and of the circle of confusion around it.
        own = 0.5 * focal * sizes[n] / z
        blur = 0.5 * focal * _APERTURE * abs(1.0 / z - 1.0 / focus)
        radius = own + blur + _SMALLEST
        reach = radius + _SMALLEST
        left, right = max(0, int(np.ceil(u - reach))), min(width - 1, int(np.floor(u + reach)))
        top, bottom = max(0, int(np.ceil(v - reach))), min(height - 1, int(np.floor(v + reach)))
        if left > right or top > bottom:
            continue
        for c in range(3):
            shine[c] = water.ambient[c] * np.exp(-water.attenuation[c] * away)
        for k in range(lamps.position.shape[0]):
            strength, way = arriving(lamps, k, places[n, 0], places[n, 1], places[n, 2])
            for c in range(3):
                lost = np.exp(-water.attenuation[c] * (way + away))
                shine[c] += strength * lamps.power[k, c] * lost
        # The light of its own picture is spread over the disc: it covers so much of what is behind.
        cover = min(1.0, own * own / (radius * radius))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                if distance[row, column] < away:
                    continue
                off = np.sqrt((column - u) ** 2 + (row - v) ** 2)
                share = min(1.0, max(0.0, (reach - off) / (2.0 * _SMALLEST))) * cover
                for c in range(3):
                    behind = light[row, column, c]
                    light[row, column, c] = behind + share * (_ALBEDO * shine[c] - behind)
