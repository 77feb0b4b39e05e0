"""What a ray sees where it landed: the light that comes back along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled_sums
from pipeline_tracker.simulation.landing import BED, FIRST_THING, NOTHING, PIPE, Landed, Tube
from pipeline_tracker.simulation.light import Haze, Lamps, Water, arriving, haze_at
from pipeline_tracker.simulation.materials import (
    BedMaterial,
    PipeMaterial,
    Surface,
    bed_surface,
    pipe_surface,
    stone_surface,
    thing_surface,
)

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]


class Materials(NamedTuple):
    """What they look like; stones are of the bed's material, things have one row each."""

    pipe: PipeMaterial
    bed: BedMaterial
    things: Array


class Lighting(NamedTuple):
    """Lamps in the world, the water, and the haze before one camera."""

    lamps: Lamps
    water: Water
    haze: Haze


class Eye(NamedTuple):
    """Where rays start (world, m), and the width of a pixel, rad."""

    origin: Array
    pixel: float


@compiled_sums
def _surface(
    landed: Landed, r: int, footprint: float, materials: Materials, tube: Tube
) -> tuple[Surface, float, float, float]:
    """Return the surface at a hit and its normal, tilted by the small relief."""
    nx, ny, nz = landed.normal[r, 0], landed.normal[r, 1], landed.normal[r, 2]
    a, b = landed.local[r, 0], landed.local[r, 1]
    p = landed.place
    if landed.kind[r] == PIPE:
        surface = pipe_surface(a, b, nz, footprint, materials.pipe)
        i = min(max(int((a - tube.start) / tube.step), 0), tube.up.shape[0] - 1)
        tx = tube.up[i, 1] * tube.right[i, 2] - tube.up[i, 2] * tube.right[i, 1]
        ty = tube.up[i, 2] * tube.right[i, 0] - tube.up[i, 0] * tube.right[i, 2]
        tz = tube.up[i, 0] * tube.right[i, 1] - tube.up[i, 1] * tube.right[i, 0]
        # The way around grows along tangent x normal.
        ax, ay, az = ty * nz - tz * ny, tz * nx - tx * nz, tx * ny - ty * nx
        nx -= surface.slope_a * tx + surface.slope_b * ax
        ny -= surface.slope_a * ty + surface.slope_b * ay
        nz -= surface.slope_a * tz + surface.slope_b * az
    elif landed.kind[r] == BED:
        surface = bed_surface(a, b, footprint, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    elif landed.kind[r] >= FIRST_THING:
        row = materials.things[landed.kind[r] - FIRST_THING]
        surface = thing_surface(a, b, nz, footprint, row, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    else:
        surface = stone_surface(p[r, 0], p[r, 1], p[r, 2], a, footprint, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    return surface, nx / norm, ny / norm, nz / norm


@compiled_sums
def shade(
    landed: Landed,
    lit: Float32Array,
    pixels: Float32Array,
    eye: Eye,
    lighting: Lighting,
    tube: Tube,
    materials: Materials,
) -> Float32Array:
    """Return the light that arrives along N rays.

    Args:
        landed: where they landed.
        lit: (N, L) float32, share of lamp l that is not hidden from the place.
        pixels: (N, 2), column and row in the image as shares 0 to 1, for the haze.
        eye: the camera.
        lighting: lamps, water and haze.
        tube: the pipe's frames.
        materials: of pipe and bed.

    Returns:
        (N, 3) float32, red, green, blue.
    """
    lamps, water, haze = lighting
    origin = eye.origin
    n = landed.kind.size
    result = np.zeros((n, 3), np.float32)
    light = np.zeros(3)
    for r in range(n):
        distance = landed.distance[r]
        if landed.kind[r] != NOTHING:
            x, y, z = landed.place[r, 0], landed.place[r, 1], landed.place[r, 2]
            facing = (
                (origin[0] - x) * landed.normal[r, 0]
                + (origin[1] - y) * landed.normal[r, 1]
                + (origin[2] - z) * landed.normal[r, 2]
            ) / distance
            footprint = eye.pixel * distance / np.sqrt(max(facing, 0.1))
            surface, nx, ny, nz = _surface(landed, r, footprint, materials, tube)
            for c in range(3):
                light[c] = (
                    water.ambient[c] * (0.6 + 0.4 * nz) * np.exp(-water.attenuation[c] * distance)
                )
            for k in range(lamps.position.shape[0]):
                if lit[r, k] <= 0.0:
                    continue
                strength, way = arriving(lamps, k, x, y, z)
                slant = (
                    (lamps.position[k, 0] - x) * nx
                    + (lamps.position[k, 1] - y) * ny
                    + (lamps.position[k, 2] - z) * nz
                ) / way
                if slant <= 0.0:
                    continue
                strength *= lit[r, k]
                for c in range(3):
                    light[c] += (
                        strength
                        * slant
                        * lamps.power[k, c]
                        * np.exp(-water.attenuation[c] * (way + distance))
                    )
            result[r, 0] = surface.red * light[0]
            result[r, 1] = surface.green * light[1]
            result[r, 2] = surface.blue * light[2]
        red, green, blue = haze_at(haze, pixels[r, 0], pixels[r, 1], distance)
        result[r, 0] += red
        result[r, 1] += green
        result[r, 2] += blue
    return result
