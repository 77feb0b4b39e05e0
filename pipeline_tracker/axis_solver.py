"""The steps of the fit of an axis, compiled: robust weights, normal equations, Gauss-Newton.

An axis is its rows here, see ``bent_axis``; parameters are those of ``axis_fit.AxisFit``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.bent_axis import move_along, nearest_to_points, nearest_to_ray
from pipeline_tracker.jit import compiled, compiled_sums

Array = NDArray[np.float64]

PARAMETERS = 6
# The noise is measured by residuals within this width, of at least so many points, and believed
# between these bounds.
_TELLING_WIDTH, _TELLING_POINTS = 6.0, 20
_LEAST_NOISE, _MOST_NOISE = 0.6, 2.5


@compiled
def _cross(a: Array, b: Array, out: Array) -> float:
    """Fill the cross product of two vectors, and return its length."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return float(np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]))


@compiled
def fill_across(direction: Array, vertical: Array, left: Array, up: Array) -> None:
    """Fill both vectors, (3,), as ``axis_fit.across`` returns them."""
    norm = _cross(vertical, direction, left)
    if norm < 1e-6:
        other = np.zeros(3)
        other[np.argmin(np.abs(direction))] = 1.0
        norm = _cross(other, direction, left)
    left /= norm
    _cross(direction, left, up)


@compiled
def _expected(expected: Array, start: Array, left: Array, up: Array, mean: Array) -> None:
    """Fill the parameters, (6,), that an expected axis has relative to a fit's start."""
    t = 0.0
    for k in range(3):
        t += (start[0, k] - expected[0, k]) * expected[1, k]
    there = np.empty((3, 3))
    move_along(expected, t, there)
    mean[:] = 0.0
    for k in range(3):
        off, turn = there[0, k] - start[0, k], there[1, k] - start[1, k]
        mean[0] += off * left[k]
        mean[1] += off * up[k]
        mean[2] += turn * left[k]
        mean[3] += turn * up[k]
        # No bend is expected.
        mean[4] -= start[2, k] * left[k]
        mean[5] -= start[2, k] * up[k]


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
    shifts: Array,
) -> None:
    """Fill residuals in standard deviations, surface points first, and their derivatives.

    A residual is a distance between a place of the axis and a point or a ray. To first order it
    changes by the axis' own shift there along the line that joins them: which place is nearest does
    not matter.

    Args:
        parameters: (6,).
        frame: rows p, d, left, up, bend of the start.
        radius: m.
        points: (3, N), x, y and z of ``axis_fit.Evidence.points``.
        point_sigmas, rays, origins, sides, ray_sigmas: see ``axis_fit.Evidence``.
        out: (N + M,), filled.
        shifts: (3, N + M), filled: what a shift of the axis by 1 m to the left and up does to each
            residual, and t of the place, m.
    """
    axis = np.empty((3, 3))
    _moved_axis(parameters, frame, axis)
    n = points.shape[1]
    _point_residuals(
        points,
        point_sigmas,
        axis,
        frame,
        radius,
        out[:n],
        shifts[0, :n],
        shifts[1, :n],
        shifts[2, :n],
    )
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
        shifts[0, n + j], shifts[1, n + j], shifts[2, n + j] = left, up, t


@compiled
def _point_residuals(
    points: Array,
    sigmas: Array,
    axis: Array,
    frame: Array,
    radius: float,
    out: Array,
    lefts: Array,
    ups: Array,
    places: Array,
) -> None:
    """Fill those of the points, all (N,), see ``_residuals``."""
    nearest = np.empty((5, points.shape[1]))
    nearest_to_points(axis, points, nearest)
    distances, vx, vy, vz = nearest[0], nearest[1], nearest[2], nearest[3]
    lx, ly, lz = frame[2, 0], frame[2, 1], frame[2, 2]
    ux, uy, uz = frame[3, 0], frame[3, 1], frame[3, 2]
    for i in range(distances.shape[0]):
        distance = max(1e-9, distances[i])
        out[i] = (distance - radius) / sigmas[i]
        scale = -1.0 / (distance * sigmas[i])
        lefts[i] = scale * (vx[i] * lx + vy[i] * ly + vz[i] * lz)
        ups[i] = scale * (vx[i] * ux + vy[i] * uy + vz[i] * uz)
    places[:] = nearest[4]


@compiled_sums
def _normal_equations(
    shifts: Array, residuals: Array, weights: Array, hessian: Array, gradient: Array
) -> None:
    """Add weighted JᵀJ and Jᵀr to ``hessian``, (6, 6), and ``gradient``, (6,).

    Args:
        shifts, residuals: see ``_residuals``. A shift to the left and up grows with t by the
            direction's parameters, and with t² / 2 by the bend's.
        weights: (N,).
        hessian, gradient: changed.
    """
    lefts, ups, places = shifts[0], shifts[1], shifts[2]
    ll0, ll1, ll2, ll3, ll4 = 0.0, 0.0, 0.0, 0.0, 0.0
    lu0, lu1, lu2, lu3, lu4 = 0.0, 0.0, 0.0, 0.0, 0.0
    uu0, uu1, uu2, uu3, uu4 = 0.0, 0.0, 0.0, 0.0, 0.0
    l0, l1, l2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(residuals.shape[0]):
        t, half = places[i], 0.5 * places[i] * places[i]
        wl, wu = weights[i] * lefts[i], weights[i] * ups[i]
        ll, lu, uu = wl * lefts[i], wl * ups[i], wu * ups[i]
        lr, ur = wl * residuals[i], wu * residuals[i]
        ll0 += ll
        ll1 += t * ll
        ll2 += half * ll
        ll3 += half * t * ll
        ll4 += half * half * ll
        lu0 += lu
        lu1 += t * lu
        lu2 += half * lu
        lu3 += half * t * lu
        lu4 += half * half * lu
        uu0 += uu
        uu1 += t * uu
        uu2 += half * uu
        uu3 += half * t * uu
        uu4 += half * half * uu
        l0 += lr
        l1 += t * lr
        l2 += half * lr
        u0 += ur
        u1 += t * ur
        u2 += half * ur
    _add_products(hessian, 0, 0, ll0, ll1, ll2, ll3, ll4)
    _add_products(hessian, 0, 1, lu0, lu1, lu2, lu3, lu4)
    _add_products(hessian, 1, 0, lu0, lu1, lu2, lu3, lu4)
    _add_products(hessian, 1, 1, uu0, uu1, uu2, uu3, uu4)
    gradient[0] += l0
    gradient[1] += u0
    gradient[2] += l1
    gradient[3] += u1
    gradient[4] += l2
    gradient[5] += u2


@compiled
def _add_products(
    hessian: Array, a: int, b: int, s0: float, s1: float, s2: float, s3: float, s4: float
) -> None:
    """Add sums of products with 1, t, h = t² / 2, t h and h² where a shift meets another's."""
    hessian[a, b] += s0
    hessian[a, 2 + b] += s1
    hessian[2 + a, b] += s1
    hessian[a, 4 + b] += s2
    hessian[4 + a, b] += s2
    # t times t is twice h.
    hessian[2 + a, 2 + b] += 2.0 * s2
    hessian[2 + a, 4 + b] += s3
    hessian[4 + a, 2 + b] += s3
    hessian[4 + a, 4 + b] += s4


@compiled
def _weigh(residuals: Array, width: float, weights: Array) -> None:
    """Fill Tukey's weights, 0 to 1, of residuals, (N,)."""
    for i in range(residuals.shape[0]):
        ratio = residuals[i] / width
        inside = max(0.0, 1.0 - ratio * ratio)
        weights[i] = inside * inside


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
    point_weight: float,
    ray_weights: Array,
    information: Array,
    mean: Array,
    widths: Array,
    parameters: Array,
    hessian: Array,
    weights: Array,
) -> float:
    """Move the parameters step by step, with Tukey's weights of one width after the other.

    Args:
        frame, radius, points: see ``_residuals``.
        point_sigmas, rays, origins, sides, ray_sigmas, point_weight, ray_weights: see
            ``axis_fit.Evidence``.
        information, mean: of the prior, (6,) and (6,).
        widths: robust widths in standard deviations.
        parameters: (6,), moved; NaN where the evidence has numbers that are none.
        hessian: (6, 6), filled: that of the last step.
        weights: (N + M,), filled: those of the last step, 0 to 1.

    Returns:
        Measured over assumed noise of the points.
    """
    n = points.shape[1]
    size = weights.shape[0]
    residuals = np.empty(size)
    shifts = np.empty((3, size))
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
            shifts,
        )
        _weigh(residuals[:n], noise * width, weights[:n])
        _weigh(residuals[n:], width, weights[n:])
        scaled[:n] = point_weight / (noise * noise) * weights[:n]
        scaled[n:] = ray_weights * weights[n:]
        hessian[:] = np.diag(information)
        gradient = information * (parameters - mean)
        _normal_equations(shifts, residuals, scaled, hessian, gradient)
        if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()):
            parameters[:] = np.nan
            break
        parameters -= np.linalg.solve(hessian, gradient)
        noise = _noise(residuals[:n], weights[:n], width, scaled)
    return noise


@compiled
def fit_rows(
    start: Array,
    vertical: Array,
    expected: Array,
    sigmas: Array,
    radius: float,
    points: Array,
    point_sigmas: Array,
    rays: Array,
    origins: Array,
    sides: Array,
    ray_sigmas: Array,
    point_weight: float,
    ray_weights: Array,
    widths: Array,
    axis: Array,
    across_it: Array,
    hessian: Array,
    weights: Array,
) -> float:
    """Fit an axis, see ``axis_fit.fit_axis``.

    Args:
        start, expected: rows of the first guess and of the prior's axis.
        vertical, radius, widths: see ``axis_fit.fit_axis``.
        sigmas: of the prior, (6,).
        points, point_sigmas, rays, origins, sides, ray_sigmas, point_weight, ray_weights: see
            ``axis_fit.Evidence``.
        axis: (3, 3), filled with the rows of the fit.
        across_it: (2, 3), filled with left and up.
        hessian, weights: filled, see ``_gauss_newton``.

    Returns:
        Measured over assumed noise of the points.
    """
    left, up = across_it[0], across_it[1]
    fill_across(start[1], vertical, left, up)
    frame = np.empty((5, 3))
    frame[:2] = start[:2]
    frame[2], frame[3], frame[4] = left, up, start[2]
    mean, parameters = np.empty(PARAMETERS), np.zeros(PARAMETERS)
    _expected(expected, start, left, up, mean)
    noise = _gauss_newton(
        frame,
        radius,
        np.ascontiguousarray(points.T),
        point_sigmas,
        rays,
        origins,
        sides,
        ray_sigmas,
        point_weight,
        ray_weights,
        1.0 / np.square(sigmas),
        mean,
        widths,
        parameters,
        hessian,
        weights,
    )
    moved = np.empty((3, 3))
    _moved_axis(parameters, frame, moved)
    move_along(moved, 0.0, axis)
    return noise
