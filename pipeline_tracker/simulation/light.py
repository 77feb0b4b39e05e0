"""Lamps and water: how much light arrives, and the haze before it.

Everything here is in the left camera's frame or in base_link turned to it: lamps and cameras ride
on the same vehicle, so the haze is the same for every frame of a run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.jit import compiled_sums
from pipeline_tracker.simulation.lens import Lens
from pipeline_tracker.simulation.scenario import LampModel, Scenario

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

# The haze is tabled on a coarse grid of the image and of ranges; it is smooth.
_COLUMNS, _ROWS, _RANGES, _FARTHEST, _SUBSTEPS = 41, 28, 48, 14.0, 8


class Lamps(NamedTuple):
    """Lamps as arrays of L rows.

    Attributes:
        position, direction: (L, 3), m and unit.
        sharpness: (L,), ln 2 over the half angle to the power 4.
        power: (L, 3), red, green, blue.
        radius: (L,), m.
    """

    position: Array
    direction: Array
    sharpness: Array
    power: Array
    radius: Array

    def moved(self, pose: Pose) -> Lamps:
        """Return the lamps in the frame to which ``pose`` leads."""
        return self._replace(
            position=pose.apply(self.position), direction=pose.rotate(self.direction)
        )


class Water(NamedTuple):
    """The water's coefficients, (3,) each: red, green, blue."""

    attenuation: Array
    backscatter: Array
    ambient: Array


class Haze(NamedTuple):
    """Light scattered into the camera up to a range, by direction.

    Attributes:
        table: (rows, columns, ranges, 3) float32.
        farthest: range of the last entry, m; entries lie at squares of evenly spaced numbers.
    """

    table: Float32Array
    farthest: float


def lamps_of(models: tuple[LampModel, ...]) -> Lamps:
    """Return a scenario's lamps in base_link."""
    direction = np.array([lamp.direction for lamp in models], dtype=np.float64)
    half = np.deg2rad([lamp.half_angle_deg for lamp in models])
    return Lamps(
        np.array([lamp.position for lamp in models], dtype=np.float64),
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        np.log(2.0) / half**4,
        np.array([lamp.power * np.array(lamp.colour) for lamp in models]),
        np.array([lamp.radius for lamp in models], dtype=np.float64),
    )


@compiled_sums
def arriving(lamps: Lamps, k: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Return what lamp k sends to a place, without water.

    Returns:
        Irradiance across the beam (power 1, 1 m away: 1) and the distance, m.
    """
    dx = x - lamps.position[k, 0]
    dy = y - lamps.position[k, 1]
    dz = z - lamps.position[k, 2]
    square = max(dx * dx + dy * dy + dz * dz, 0.0025)
    distance = np.sqrt(square)
    d = lamps.direction
    cosine = (dx * d[k, 0] + dy * d[k, 1] + dz * d[k, 2]) / distance
    angle = np.arccos(min(1.0, max(-1.0, cosine)))
    angle *= angle
    return np.exp(-lamps.sharpness[k] * angle * angle) / square, distance


@compiled_sums
def _haze_table(directions: Array, ranges: Array, lamps: Lamps, water: Water) -> Float32Array:
    rows, columns = directions.shape[:2]
    table = np.zeros((rows, columns, ranges.size, 3), np.float32)
    for i in range(rows):
        for j in range(columns):
            d = directions[i, j]
            total = np.zeros(3)
            for n in range(1, ranges.size):
                step = (ranges[n] - ranges[n - 1]) / _SUBSTEPS
                for m in range(_SUBSTEPS):
                    r = ranges[n - 1] + (m + 0.5) * step
                    for k in range(lamps.position.shape[0]):
                        light, way = arriving(lamps, k, r * d[0], r * d[1], r * d[2])
                        for c in range(3):
                            seen = np.exp(-water.attenuation[c] * (way + r))
                            total[c] += (
                                step * water.backscatter[c] * light * lamps.power[k, c] * seen
                            )
                    for c in range(3):
                        seen = np.exp(-water.attenuation[c] * r)
                        total[c] += step * water.backscatter[c] * water.ambient[c] * seen
                table[i, j, n] = total
    return table


def haze_of(lens: Lens, lamps: Lamps, water: Water) -> Haze:
    """Integrate the light scattered once into a camera; shadows in the water are left out.

    Args:
        lens: the camera as it is built.
        lamps: in the rectified camera's own frame.
        water: the water.
    """
    x = np.linspace(-0.5, lens.camera.width - 0.5, _COLUMNS)
    y = np.linspace(-0.5, lens.camera.height - 0.5, _ROWS)
    directions = lens.rays(np.stack(np.meshgrid(x, y), axis=-1))
    ranges = _FARTHEST * np.linspace(0.0, 1.0, _RANGES) ** 2
    return Haze(_haze_table(directions, ranges, lamps, water), _FARTHEST)


@compiled_sums
def haze_at(haze: Haze, column: float, row: float, distance: float) -> tuple[float, float, float]:
    """Look the haze up: red, green, blue.

    Args:
        haze: the table.
        column, row: place in the image, 0 to 1 each.
        distance: range of what is seen, m.
    """
    table = haze.table
    rows, columns, ranges = table.shape[0], table.shape[1], table.shape[2]
    y = min(max(row, 0.0), 1.0) * (rows - 1)
    x = min(max(column, 0.0), 1.0) * (columns - 1)
    z = np.sqrt(min(distance / haze.farthest, 1.0)) * (ranges - 1)
    i = min(int(y), rows - 2)
    j = min(int(x), columns - 2)
    n = min(int(z), ranges - 2)
    fy = y - i
    fx = x - j
    fz = z - n
    red, green, blue = 0.0, 0.0, 0.0
    for a in range(2):
        wy = fy if a else 1.0 - fy
        for b in range(2):
            w = wy * (fx if b else 1.0 - fx)
            low, high = table[i + a, j + b, n], table[i + a, j + b, n + 1]
            red += w * (low[0] + fz * (high[0] - low[0]))
            green += w * (low[1] + fz * (high[1] - low[1]))
            blue += w * (low[2] + fz * (high[2] - low[2]))
    return red, green, blue


def reference_light(scenario: Scenario, lamps: Lamps) -> Array:
    """Return the lamps' irradiance on the level bed where the left camera looks, (3,).

    Args:
        scenario: for camera, height above the bed and water.
        lamps: in base_link.
    """
    mounting = scenario.camera.mounting()
    axis = mounting.rotation[:, 2]
    height = scenario.path.distance + scenario.pipe.diameter * (1.0 - scenario.bed.burial)
    # A camera that looks at or above the horizon is metered a few heights ahead.
    place = mounting.translation + axis * height / max(-float(axis[2]), 0.2)
    attenuation = np.array(scenario.water.attenuation)
    total = np.zeros(3)
    for k in range(len(lamps.position)):
        light, way = arriving(lamps, k, *place)
        slant = max(0.0, float(lamps.position[k, 2] - place[2])) / way
        seen = way + float(np.linalg.norm(place - mounting.translation))
        total += light * slant * lamps.power[k] * np.exp(-attenuation * seen)
    return total


def water_of(scenario: Scenario, reference: Array) -> Water:
    """Return the scenario's water; its ambient light is relative to ``reference`` (3,)."""
    attenuation = np.array(scenario.water.attenuation, dtype=np.float64)
    return Water(
        attenuation,
        np.array(scenario.water.backscatter, dtype=np.float64),
        # Light from the surface has lost its red as the lamps' has on its way.
        scenario.water.ambient * reference,
    )
