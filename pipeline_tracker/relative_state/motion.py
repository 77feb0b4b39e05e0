"""The vehicle's attitude and motion at a frame (4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose

Array = NDArray[np.float64]

# Error of a VNM displacement, one sigma for each axis: that of its two ends, and a share of the way
# for drift. VNM promises less than a centimetre over a step.
END_SIGMA = 0.003
DRIFT_SHARE = 0.01
# Variance of an angle of which nothing is known.
_UNKNOWN_ANGLE = math.pi**2 / 3.0


def heading_rotation(pose: Pose) -> Array:
    """Return Rz(yaw) of a pose: the rotation odom <- levelled base_link, 3 x 3."""
    yaw = math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Motion:
    """Displacement S of base_link's origin and the time that it took.

    Attributes:
        way: S in levelled base_link, (3,), m.
        duration: s.
        observed: whether the horizontal speed is enough for S to have a direction.
    """

    way: Array
    duration: float
    observed: bool

    @classmethod
    def between(cls, before: Pose, after: Pose, duration: float, min_speed: float) -> Motion:
        """Build the motion between two poses of base_link in odom.

        Args:
            before: pose at the beginning.
            after: pose at the end; its yaw gives the levelled frame.
            duration: time between them, s, above 0.
            min_speed: least horizontal speed that has a direction, m/s.
        """
        way = heading_rotation(after).T @ (after.translation - before.translation)
        speed = float(np.hypot(way[0], way[1])) / duration
        return cls(way, duration, speed >= min_speed and speed > 0.0)

    @property
    def velocity(self) -> Array:
        """Velocity u = S / time, (3,), m/s."""
        return self.way / self.duration

    @property
    def variance(self) -> float:
        """Variance of S for each axis, m²."""
        return END_SIGMA**2 + (DRIFT_SHARE * float(np.linalg.norm(self.way))) ** 2

    @property
    def heading_variance(self) -> float:
        """Variance of the heading of S, rad²."""
        return min(_UNKNOWN_ANGLE, self.variance / float(self.way[0] ** 2 + self.way[1] ** 2))

    @property
    def pitch_variance(self) -> float:
        """Variance of the elevation of S, rad²."""
        return min(_UNKNOWN_ANGLE, self.variance / float(self.way @ self.way))

    @property
    def speed_variance(self) -> float:
        """Variance of one component of u, m²/s²."""
        return self.variance / self.duration**2
