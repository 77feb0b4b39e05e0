"""True heading, pitch, distance, offset and approach speed (4.3), from the truth alone.

Written out here a second time, on purpose: a sign that is wrong in the method must not be wrong in
its measure too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose

Array = NDArray[np.float64]

# A steeper pipe has neither heading nor sides.
_VERTICAL = 0.05


@dataclass(frozen=True)
class TrueFrame:
    """What is true in a frame, in world.

    Attributes:
        point: a point of the true axis, (3,), m.
        direction: its direction along travel, (3,), unit.
        radius: m.
        pose: world <- base_link.
        camera: centre of the left camera, (3,), m; None where the mounting is not known.
        way: the direction that angles are measured from: the displacement, or the levelled x axis.
        velocity: of base_link's origin, (3,), m/s; None unknown.
    """

    point: Array
    direction: Array
    radius: float
    pose: Pose
    camera: Array | None
    way: Array
    velocity: Array | None

    def numbers(self) -> dict[str, float]:
        """Return the true values by the names of the table's columns; unknown ones are left out."""
        d, origin = self.direction, self.pose.translation
        across = math.hypot(d[0], d[1])
        values = {"pitch_misalignment": _elevation(d) - _elevation(self.way)}
        if across > _VERTICAL:
            turn = math.atan2(d[1], d[0]) - math.atan2(self.way[1], self.way[0])
            values["heading_misalignment"] = math.remainder(turn, 2.0 * math.pi)
            aside = origin - self.point
            values["lateral_offset"] = float(d[0] * aside[1] - d[1] * aside[0]) / across
        if self.camera is not None:
            values["min_distance"] = self._reach(self.camera) - self.radius
        if self.velocity is not None:
            # How fast the distance shrinks, from two places of the vehicle.
            step = 1e-3
            ahead = self._reach(origin + step * self.velocity)
            values["approach_speed"] = (self._reach(origin - step * self.velocity) - ahead) / (
                2.0 * step
            )
        return values

    def _reach(self, place: Array) -> float:
        return float(np.linalg.norm(np.cross(place - self.point, self.direction)))


def wrapped_error(name: str, estimate: float, truth: float) -> float:
    """Return estimate less truth; the difference of two headings within -pi and pi."""
    error = estimate - truth
    return math.remainder(error, 2.0 * math.pi) if name == "heading_misalignment" else error


def _elevation(vector: Array) -> float:
    return math.asin(float(np.clip(vector[2] / np.linalg.norm(vector), -1.0, 1.0)))
