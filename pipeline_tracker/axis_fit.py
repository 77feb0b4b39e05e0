"""Robust fit of the pipe's axis to surface points and contours, with its covariance.

Beyond the paper: the continuous optimum that follows its discrete candidates (4.1) and its
closed-form techniques (4.2.4). All coordinates are in the left optical frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.bent_axis import nearest_to_point, nearest_to_ray
from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

_PARAMETERS = 6
# Robust width, in standard deviations: from wide to narrow, so that a start 10 cm off is caught.
_ANNEALING = (24.0, 12.0, 6.0, 4.0, 4.0, 4.0)
# The noise is measured by residuals within this width, of at least so many points, and believed
# between these bounds.
_TELLING_WIDTH, _TELLING_POINTS = 6.0, 20
_LEAST_NOISE, _MOST_NOISE = 0.6, 2.5
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
        tangent = self.tangent(t)
        bend = self.bend - tangent * float(np.dot(self.bend, tangent))
        return Axis(self.at(t), tangent, bend)

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

    def only_points(self) -> Evidence:
        """Return the same without contours."""
        none = np.zeros(0)
        return replace(
            self,
            rays=np.zeros((0, 3)),
            origins=np.zeros((0, 3)),
            sides=none,
            ray_sigmas=none,
            ray_weights=none,
        )


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

    def mean(self, start: Axis, left: Array, up: Array) -> Array:
        """Return the expected parameters relative to a fit's start, (6,)."""
        t = float((start.point - self.axis.point) @ self.axis.direction)
        there = self.axis.moved(t)
        off, turn = there.point - start.point, there.direction - start.direction
        return np.array(
            [off @ left, off @ up, turn @ left, turn @ up, -start.bend @ left, -start.bend @ up]
        )


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
    left = np.cross(vertical, direction)
    norm = float(np.linalg.norm(left))
    if norm < 1e-6:
        left = np.cross(np.eye(3)[int(np.argmin(np.abs(direction)))], direction)
        norm = float(np.linalg.norm(left))
    left = left / norm
    return left, np.cross(direction, left)


@compiled
def _moved_axis(parameters: Array, frame: Array, axis: Array) -> None:
    """Fill the rows of the axis that parameters make of the start, see ``bent_axis``."""
    for k in range(3):
        left, up = frame[2, k], frame[3, k]
        axis[0, k] = frame[0, k] + parameters[0] * left + parameters[1] * up
        axis[1, k] = frame[1, k] + parameters[2] * left + parameters[3] * up
        axis[2, k] = frame[4, k] + parameters[4] * left + parameters[5] * up


@compiled
def _residuals(
    parameters: Array,
    frame: Array,
    radius: float,
    points: Array,
    point_sigmas: Array,
    rays: Array,
    origins: Array,
    sides: Array,
    ray_sigmas: Array,
    out: Array,
    jacobian: Array,
) -> None:
    """Fill residuals in standard deviations, surface points first, and their derivatives.

    A residual is a distance between a place of the axis and a point or a ray. To first order it
    changes by the axis' own shift there along the line that joins them: which place is nearest does
    not matter.

    Args:
        parameters: (6,).
        frame: rows p, d, left, up, bend of the start.
        radius: m.
        points, point_sigmas, rays, origins, sides, ray_sigmas: see ``Evidence``.
        out: (N + M,), filled.
        jacobian: (6, N + M), filled.
    """
    axis = np.empty((3, 3))
    _moved_axis(parameters, frame, axis)
    n = points.shape[0]
    for i in range(n):
        distance, vx, vy, vz, t = nearest_to_point(axis, points[i, 0], points[i, 1], points[i, 2])
        distance = max(1e-9, distance)
        out[i] = (distance - radius) / point_sigmas[i]
        scale = -1.0 / (distance * point_sigmas[i])
        left = vx * frame[2, 0] + vy * frame[2, 1] + vz * frame[2, 2]
        up = vx * frame[3, 0] + vy * frame[3, 1] + vz * frame[3, 2]
        _shifts(jacobian, i, scale * left, scale * up, t)
    for j in range(rays.shape[0]):
        aside, depth, t, mx, my, mz = nearest_to_ray(
            axis, origins[j, 0], rays[j, 0], rays[j, 1], rays[j, 2]
        )
        norm = max(1e-9, np.sqrt(mx * mx + my * my + mz * mz))
        reach = max(depth, 0.1) * ray_sigmas[j]
        out[n + j] = (sides[j] * aside - radius) / reach
        scale = -sides[j] / (norm * reach)
        left = scale * (mx * frame[2, 0] + my * frame[2, 1] + mz * frame[2, 2])
        up = scale * (mx * frame[3, 0] + my * frame[3, 1] + mz * frame[3, 2])
        # Farther away, the same distance is fewer standard deviations.
        farther = out[n + j] / (max(depth, 0.1) * max(1e-9, norm * norm))
        for k in range(3):
            left -= farther * rays[j, k] * frame[2, k]
            up -= farther * rays[j, k] * frame[3, k]
        _shifts(jacobian, n + j, left, up, t)


@compiled
def _shifts(jacobian: Array, i: int, left: float, up: float, t: float) -> None:
    """Fill column i: what a shift to the left and up, growing with t or t², does to a residual."""
    jacobian[0, i] = left
    jacobian[1, i] = up
    jacobian[2, i] = t * left
    jacobian[3, i] = t * up
    jacobian[4, i] = 0.5 * t * t * left
    jacobian[5, i] = 0.5 * t * t * up


@compiled
def _normal_equations(
    jacobian: Array, residuals: Array, weights: Array, hessian: Array, gradient: Array
) -> None:
    """Add weighted JᵀJ and Jᵀr to ``hessian`` and ``gradient``."""
    size = hessian.shape[0]
    for i in range(residuals.shape[0]):
        w = weights[i]
        if w == 0.0:
            continue
        for a in range(size):
            wa = w * jacobian[a, i]
            gradient[a] += wa * residuals[i]
            for b in range(a + 1):
                hessian[a, b] += wa * jacobian[b, i]
    for a in range(size):
        for b in range(a):
            hessian[b, a] = hessian[a, b]


@compiled
def _noise(residuals: Array, weights: Array, width: float, room: Array) -> float:
    """Measured over assumed noise, by the median; 1 where there is too little to tell."""
    if width > _TELLING_WIDTH:
        return 1.0
    count = 0
    for i in range(residuals.shape[0]):
        if weights[i] > 0.0:
            room[count] = abs(residuals[i])
            count += 1
    if count < _TELLING_POINTS:
        return 1.0
    return min(max(1.4826 * np.median(room[:count]), _LEAST_NOISE), _MOST_NOISE)


@compiled
def _gauss_newton(
    frame: Array,
    radius: float,
    points: Array,
    point_sigmas: Array,
    rays: Array,
    origins: Array,
    sides: Array,
    ray_sigmas: Array,
    base: Array,
    information: Array,
    mean: Array,
    widths: Array,
    parameters: Array,
    hessian: Array,
    weights: Array,
) -> float:
    """Move the parameters step by step, with Tukey's weights of one width after the other.

    Args:
        frame, radius: see ``_residuals``.
        points, point_sigmas, rays, origins, sides, ray_sigmas: see ``Evidence``.
        base: weight of each point and ray before any step, (N + M,).
        information, mean: of the prior, (6, 6) and (6,).
        widths: robust widths in standard deviations.
        parameters: (6,), moved; NaN where the evidence has numbers that are none.
        hessian: (6, 6), filled: that of the last step.
        weights: (N + M,), filled: those of the last step, 0 to 1.

    Returns:
        Measured over assumed noise of the points.
    """
    n = points.shape[0]
    size = base.shape[0]
    residuals = np.empty(size)
    jacobian = np.empty((_PARAMETERS, size))
    scaled = np.empty(size)
    noise = 1.0
    for width in widths:
        _residuals(
            parameters,
            frame,
            radius,
            points,
            point_sigmas,
            rays,
            origins,
            sides,
            ray_sigmas,
            residuals,
            jacobian,
        )
        for i in range(size):
            scale = noise if i < n else 1.0
            ratio = residuals[i] / (scale * width)
            inside = max(0.0, 1.0 - ratio * ratio)
            weights[i] = inside * inside
            scaled[i] = base[i] * weights[i] / (scale * scale)
        hessian[:] = information
        gradient = information @ (parameters - mean)
        _normal_equations(jacobian, residuals, scaled, hessian, gradient)
        if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
            parameters[:] = np.nan
            break
        parameters -= np.linalg.solve(hessian, gradient)
        noise = _noise(residuals[:n], weights[:n], width, scaled)
    return noise


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
    left, up = across(start.direction, vertical)
    frame = np.stack((start.point, start.direction, left, up, start.bend))
    prior = prior or Prior.loose(start)
    information = np.diag(1.0 / np.square(prior.sigmas))
    mean = prior.mean(start, left, up)
    points = evidence.points.shape[0]
    base = np.concatenate((np.full(points, evidence.point_weight), evidence.ray_weights))
    parameters = np.zeros(_PARAMETERS)
    hessian = information.copy()
    weights = np.zeros(len(base))
    noise = _gauss_newton(
        frame,
        radius,
        evidence.points,
        evidence.point_sigmas,
        evidence.rays,
        evidence.origins,
        evidence.sides,
        evidence.ray_sigmas,
        base,
        information,
        mean,
        np.asarray(widths, np.float64),
        parameters,
        hessian,
        weights,
    )
    rows = np.empty((3, 3))
    _moved_axis(parameters, frame, rows)
    return AxisFit(
        axis=Axis(rows[0], rows[1], rows[2]).moved(0.0),
        covariance=np.asarray(np.linalg.inv(hessian), np.float64),
        left=left,
        up=up,
        noise=noise,
        point_weights=weights[:points],
        ray_weights=weights[points:],
    )
