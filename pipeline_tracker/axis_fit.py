"""Robust fit of the pipe's axis to surface points and contours, with its covariance.

Beyond the paper: the continuous optimum that follows its discrete candidates (4.1) and its
closed-form techniques (4.2.4). All coordinates are in the left optical frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_solver import PARAMETERS, fill_across, fit_rows
from pipeline_tracker.geometry.bent_axis import move_along

Array = NDArray[np.float64]

# Robust width, in standard deviations: from wide to narrow, so that a start 10 cm off is caught.
_ANNEALING = (24.0, 12.0, 6.0, 4.0, 4.0, 4.0)
# Standard deviation that the prior gives to the bend, 1/m: radii of 20 m are bends, not noise.
BEND_SIGMA = 0.03


@dataclass(frozen=True)
class Axis:
    """A gently bent axis: ``point + t * direction + t² / 2 * bend``, t in metres.

    Attributes:
        point: the axis at t = 0, (3,), m.
        direction: unit tangent at t = 0, (3,), along travel.
        bend: second derivative, (3,), 1/m, perpendicular to ``direction``.
    """

    point: Array
    direction: Array
    bend: Array

    @classmethod
    def straight(cls, point: Array, direction: Array) -> Axis:
        """Return a straight axis; the direction need not have unit length."""
        return cls(point, direction / np.linalg.norm(direction), np.zeros(3))

    @cached_property
    def rows(self) -> Array:
        """Point, direction and bend as the (3, 3) that compiled kernels take."""
        return np.array([self.point, self.direction, self.bend])

    def at(self, t: float) -> Array:
        """Return the point of the axis at t, (3,), m."""
        point: Array = self.point + t * self.direction + 0.5 * t * t * self.bend
        return point

    def tangent(self, t: float) -> Array:
        """Return the unit direction at t, (3,)."""
        vector = self.direction + t * self.bend
        tangent: Array = vector / np.linalg.norm(vector)
        return tangent

    def moved(self, t: float) -> Axis:
        """Return the same axis with its origin moved along it to t."""
        rows = np.empty((3, 3))
        move_along(self.rows, t, rows)
        return Axis(rows[0], rows[1], rows[2])

    def reversed(self) -> Axis:
        """Return the same axis, travelled the other way."""
        return Axis(self.point, -self.direction, self.bend)


@dataclass(frozen=True)
class Evidence:
    """What the pictures say about the axis.

    Attributes:
        points: surface points, (N, 3), m.
        point_sigmas: standard deviation of their distance from the axis, (N,), m.
        rays: directions, (M, 3), of points on contours.
        origins: the camera centre of each ray, (M, 3), m.
        sides: (M,) -1 left contour, +1 right contour, as seen along the axis' direction.
        ray_sigmas: standard deviation of each ray's direction, (M,), rad.
        ray_weights: (M,) weight of each ray (a long segment counts more).
        point_weight: weight of each point; below 1 where neighbours err alike.
    """

    points: Array
    point_sigmas: Array
    rays: Array
    origins: Array
    sides: Array
    ray_sigmas: Array
    ray_weights: Array
    point_weight: float = 1.0


@dataclass(frozen=True)
class Prior:
    """What was known of the axis before.

    Attributes:
        axis: the expected axis.
        sigmas: standard deviations of left m, up m, heading rad, pitch rad, bend to the left 1/m,
            bend up 1/m; (6,). The bend is expected to be 0.
    """

    axis: Axis
    sigmas: Array

    @classmethod
    def loose(cls, axis: Axis) -> Prior:
        """Return the prior of a frame without a past: only the bend is bounded."""
        return cls(axis, np.array([10.0, 10.0, 3.0, 3.0, BEND_SIGMA, BEND_SIGMA]))


@dataclass(frozen=True)
class AxisFit:
    """A fitted axis.

    Attributes:
        axis: the axis; t = 0 is the start's own reference point, moved across.
        covariance: 6 x 6: left, up, heading, pitch, bend left, bend up at t = 0.
        left, up: unit vectors across the axis, (3,): to the left seen along travel, and up.
        noise: measured over assumed noise of the surface points.
        point_weights: final weight 0 to 1 of each surface point, (N,).
        ray_weights: final weight 0 to 1 of each ray, (M,).
    """

    axis: Axis
    covariance: Array
    left: Array
    up: Array
    noise: float
    point_weights: Array
    ray_weights: Array


def across(direction: Array, vertical: Array) -> tuple[Array, Array]:
    """Return unit vectors (left, up) across a direction.

    Args:
        direction: unit direction, (3,).
        vertical: unit vector pointing up, (3,).

    Returns:
        ``left`` is horizontal, ``up`` lies in the vertical plane through the direction. For a
        vertical direction any pair across it.
    """
    left, up = np.empty(3), np.empty(3)
    fill_across(direction, vertical, left, up)
    return left, up


def fit_axis(
    start: Axis,
    radius: float,
    evidence: Evidence,
    vertical: Array,
    prior: Prior | None = None,
    widths: tuple[float, ...] = _ANNEALING,
) -> AxisFit:
    """Fit a gently bent axis of known radius to surface points and contours.

    Gauss-Newton with Tukey's weights whose width shrinks from step to step.

    Args:
        start: first guess; t = 0 should lie in the middle of what is in view.
        radius: m.
        evidence: surface points and contour rays.
        vertical: unit vector pointing up, (3,).
        prior: how well the start is known; None: only the bend is bounded.
        widths: robust widths in standard deviations, one for each step.

    Returns:
        The fit; its covariance is that of the weighted residuals, scaled by the measured noise
        where that is above the assumed one.
    """
    prior = prior or Prior.loose(start)
    points, rays = len(evidence.points), len(evidence.rays)
    axis, across_it = np.empty((3, 3)), np.empty((2, 3))
    hessian, weights = np.empty((PARAMETERS, PARAMETERS)), np.empty(points + rays)
    noise = fit_rows(
        start.rows,
        vertical,
        prior.axis.rows,
        prior.sigmas,
        radius,
        evidence.points,
        evidence.point_sigmas,
        evidence.rays,
        evidence.origins,
        evidence.sides,
        evidence.ray_sigmas,
        evidence.point_weight,
        evidence.ray_weights,
        np.array(widths, np.float64),
        axis,
        across_it,
        hessian,
        weights,
    )
    return AxisFit(
        axis=Axis(axis[0], axis[1], axis[2]),
        covariance=np.asarray(np.linalg.inv(hessian), np.float64),
        left=across_it[0],
        up=across_it[1],
        noise=noise,
        point_weights=weights[:points],
        ray_weights=weights[points:],
    )
