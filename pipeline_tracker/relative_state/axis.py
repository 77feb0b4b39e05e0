"""The straight line through a segment, in levelled base_link, and what is measured on it (4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.cylinder import nearest_point

Array = NDArray[np.float64]

# A direction whose horizontal part is smaller (within 3 degrees of the vertical) has neither
# heading nor sides nor an upper line: the error of an estimate would decide on them.
VERTICAL = 0.05
# Nearer to the axis than this there is no direction towards it, m.
_ON_AXIS = 1e-6


def elevation(vector: Array) -> float:
    """Return the angle of a vector (3,) above the horizontal, rad."""
    return math.atan2(float(vector[2]), math.hypot(float(vector[0]), float(vector[1])))


def turn_between(start: Array, end: Array) -> float:
    """Return the angle in the level plane from one vector (3,) to another, rad, + to port."""
    cross = start[0] * end[1] - start[1] * end[0]
    return math.atan2(float(cross), float(start[0] * end[0] + start[1] * end[1]))


@dataclass(frozen=True)
class LevelAxis:
    """The pipe's axis in levelled base_link: origin at base_link's, z the external vertical.

    Attributes:
        middle: middle of the segment, C_mid, (3,), m.
        direction: D, unit, (3,), along travel.
        radius: the pipe's radius, m.
        covariance: 4 x 4 of left m, up m, heading rad, pitch rad at the middle; None unknown.
    """

    middle: Array
    direction: Array
    radius: float
    covariance: Array | None

    @property
    def vertical(self) -> bool:
        """Whether the pipe is too steep for heading, lateral offset, sides and upper points."""
        return self._horizontal < VERTICAL

    @property
    def left(self) -> Array:
        """Horizontal unit normal of the axis to port, (3,)."""
        d = self.direction
        return np.array([-d[1], d[0], 0.0]) / self._horizontal

    @property
    def up(self) -> Array:
        """Unit normal of the axis in its vertical plane, upwards, (3,)."""
        return np.cross(self.direction, self.left)

    def distance(self, origin: Array) -> float:
        """Return |OQ| - r, the distance from a point (3,) to the pipe's surface, m."""
        q = nearest_point(self.middle, self.direction, origin)
        return float(np.linalg.norm(q - origin)) - self.radius

    def distance_variance(self, origin: Array) -> float:
        """Return the variance of ``distance``, m²; -1 unknown. The radius is taken as exact."""
        towards = self._towards(origin)
        if towards is None:
            return -1.0
        normal, along, _ = towards
        return self._propagate(self._motion_of(normal, along))

    def approach_speed(self, velocity: Array) -> float | None:
        """Return the part of a velocity (3,) towards the nearest point of the axis, m/s.

        Positive: base_link's origin comes nearer. None on the axis itself.
        """
        towards = self._towards(np.zeros(3))
        return None if towards is None else float(velocity @ towards[0])

    def speed_variance(self, velocity: Array) -> float:
        """Return what the axis's covariance adds to the variance of ``approach_speed``, m²/s²."""
        towards = self._towards(np.zeros(3))
        if towards is None:
            return -1.0
        normal, along, distance = towards
        # The unit vector to the axis turns about the axis when this moves aside, and with the axis.
        aside = np.cross(self.direction, normal)
        about = float(velocity @ aside) / distance * self._motion_of(aside, along)
        lengthways = float(velocity @ self.direction) * self._turn_of(normal)
        return self._propagate(about - lengthways)

    def offsets(self) -> tuple[float, float]:
        """Return lateral and vertical offset of base_link's origin, m; 0 for a vertical pipe.

        Lateral: horizontal distance from the vertical plane through the axis, + to port of the
        pipe. Vertical: height above the axis where that distance is measured.
        """
        if self.vertical:
            return 0.0, 0.0
        d, m = self.direction, self.middle
        along = -(m[0] * d[0] + m[1] * d[1]) / (d[0] ** 2 + d[1] ** 2)
        return -float(m @ self.left), -float(m[2] + along * d[2])

    def upper_points(self) -> tuple[Array, Array] | None:
        """Return Q and Q' of the section at C_mid, each (3,), m; None for a vertical pipe."""
        if self.vertical:
            return None
        z = np.array([0.0, 0.0, 1.0])
        # |z - (z·d) d| = sqrt(1 - (z·d)²) is the horizontal part of d.
        q = self.middle + self.radius * (z - self.direction[2] * self.direction) / self._horizontal
        return q, self.middle + self.radius / self._horizontal * z

    @property
    def _horizontal(self) -> float:
        return math.hypot(float(self.direction[0]), float(self.direction[1]))

    def _towards(self, origin: Array) -> tuple[Array, float, float] | None:
        """Unit vector from a point to Q, place of Q along the axis from the middle, |OQ|."""
        q = nearest_point(self.middle, self.direction, origin)
        distance = float(np.linalg.norm(q - origin))
        if not distance > _ON_AXIS:
            return None
        return (q - origin) / distance, float((q - self.middle) @ self.direction), distance

    def _turn_of(self, vector: Array) -> Array:
        """How the part of D along a vector changes with left, up, heading, pitch; (4,)."""
        heading = self._horizontal * float(vector @ self.left)
        return np.array([0.0, 0.0, heading, float(vector @ self.up)])

    def _motion_of(self, vector: Array, along: float) -> Array:
        """How the part along a vector of the axis point at ``along`` changes with them; (4,)."""
        shift = np.array([float(vector @ self.left), float(vector @ self.up), 0.0, 0.0])
        return shift + along * self._turn_of(vector)

    def _propagate(self, gradient: Array) -> float:
        if self.covariance is None or self.vertical:
            return -1.0
        return max(0.0, float(gradient @ self.covariance @ gradient))
