"""Robust fit of the pipe's axis to surface points and contours, with its covariance.

Beyond the paper: the continuous optimum that follows its discrete candidates (4.1) and its
closed-form techniques (4.2.4). All coordinates are in the left optical frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

_PARAMETERS = 6
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
def _curve(parameters: Array, frame: Array, t: float, point: Array, tangent: Array) -> None:
    """Fill ``point`` and unit ``tangent`` at t; rows of ``frame``: p, d, left, up, bend."""
    norm = 0.0
    for k in range(3):
        d = frame[1, k] + parameters[2] * frame[2, k] + parameters[3] * frame[3, k]
        b = frame[4, k] + parameters[4] * frame[2, k] + parameters[5] * frame[3, k]
        start = frame[0, k] + parameters[0] * frame[2, k] + parameters[1] * frame[3, k]
        point[k] = start + t * d + 0.5 * t * t * b
        tangent[k] = d + t * b
        norm += tangent[k] * tangent[k]
    norm = np.sqrt(norm)
    for k in range(3):
        tangent[k] /= norm


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
    x = np.empty(3)
    d = np.empty(3)
    n = points.shape[0]
    for i in range(n):
        t = 0.0
        # The nearest place of a gently bent axis: project on the tangent, twice.
        for _ in range(2):
            _curve(parameters, frame, t, x, d)
            for k in range(3):
                t += (points[i, k] - x[k]) * d[k]
        _curve(parameters, frame, t, x, d)
        along = 0.0
        square = 0.0
        left = 0.0
        up = 0.0
        for k in range(3):
            v = points[i, k] - x[k]
            along += v * d[k]
            square += v * v
            left += v * frame[2, k]
            up += v * frame[3, k]
        distance = max(1e-9, np.sqrt(max(0.0, square - along * along)))
        out[i] = (distance - radius) / point_sigmas[i]
        scale = -1.0 / (distance * point_sigmas[i])
        _shifts(jacobian, i, scale * left, scale * up, t)
    for j in range(rays.shape[0]):
        t = 0.0
        depth = 0.0
        for _ in range(3):
            _curve(parameters, frame, t, x, d)
            # Nearest places of the ray (unit) and the tangent line.
            rd = 0.0
            rw = 0.0
            dw = 0.0
            for k in range(3):
                w = x[k] - origins[j, k]
                rd += rays[j, k] * d[k]
                rw += rays[j, k] * w
                dw += d[k] * w
            slope = max(1e-9, 1.0 - rd * rd)
            t += (rd * rw - dw) / slope
            depth = (rw - rd * dw) / slope
        _curve(parameters, frame, t, x, d)
        mx = rays[j, 1] * d[2] - rays[j, 2] * d[1]
        my = rays[j, 2] * d[0] - rays[j, 0] * d[2]
        mz = rays[j, 0] * d[1] - rays[j, 1] * d[0]
        norm = max(1e-9, np.sqrt(mx * mx + my * my + mz * mz))
        aside = (
            (x[0] - origins[j, 0]) * mx + (x[1] - origins[j, 1]) * my + (x[2] - origins[j, 2]) * mz
        ) / norm
        reach = max(depth, 0.1) * ray_sigmas[j]
        out[n + j] = (-sides[j] * aside - radius) / reach
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
            for b in range(size):
                hessian[a, b] += wa * jacobian[b, i]


def _tukey(residuals: Array, width: float) -> Array:
    inside = np.clip(1.0 - np.square(residuals / width), 0.0, None)
    weights: Array = np.square(inside)
    return weights


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
    size = evidence.points.shape[0] + evidence.rays.shape[0]
    points = evidence.points.shape[0]
    parameters = np.zeros(_PARAMETERS)
    residuals = np.empty(size)
    jacobian = np.empty((_PARAMETERS, size))
    weights = np.zeros(size)
    scale = np.ones(size)
    base = np.concatenate((np.full(points, evidence.point_weight), evidence.ray_weights))
    arguments = (
        frame,
        radius,
        evidence.points,
        evidence.point_sigmas,
        evidence.rays,
        evidence.origins,
        evidence.sides,
        evidence.ray_sigmas,
    )
    hessian = information.copy()
    noise = 1.0
    for width in widths:
        _residuals(parameters, *arguments, residuals, jacobian)
        scale[:points] = noise
        weights = _tukey(residuals / scale, width)
        hessian = information.copy()
        gradient = information @ (parameters - mean)
        _normal_equations(jacobian, residuals, base * weights / np.square(scale), hessian, gradient)
        parameters = parameters - np.linalg.solve(hessian, gradient)
        noise = _noise(residuals[:points], weights[:points], width)
    point, tangent = np.empty(3), np.empty(3)
    _curve(parameters, frame, 0.0, point, tangent)
    bend = start.bend + parameters[4] * left + parameters[5] * up
    bend = bend - tangent * float(np.dot(bend, tangent))
    return AxisFit(
        axis=Axis(point, tangent, bend),
        covariance=np.asarray(np.linalg.inv(hessian), np.float64),
        left=left,
        up=up,
        noise=noise,
        point_weights=weights[:points],
        ray_weights=weights[points:],
    )


def _noise(residuals: Array, weights: Array, width: float) -> float:
    """Measured over assumed noise, by the median; 1 where there is too little to tell."""
    if width > 6.0:
        return 1.0
    inside = residuals[weights > 0.0]
    if inside.size < 20:
        return 1.0
    return float(np.clip(1.4826 * np.median(np.abs(inside)), 0.6, 2.5))
