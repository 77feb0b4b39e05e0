"""Where points and rays are nearest to a bent axis, compiled.

An axis is a (3, 3) array here: the rows p, d and b of its places ``p + t * d + t² / 2 * b``, with t
in metres along it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

# The nearest place of a gently bent axis is found by its tangent, again from there: at most so
# often, or until it moves by less than this, m (a distance changes by the square of that).
_STEPS, _STILL = 3, 1e-4
# Below this a ray runs along the axis.
_ALONG = 1e-9


@compiled
def place_and_tangent(axis: Array, t: float) -> tuple[float, float, float, float, float, float]:
    """Return the place of an axis at t, m, and its unit tangent there: x y z, dx dy dz."""
    half = 0.5 * t * t
    x = axis[0, 0] + t * axis[1, 0] + half * axis[2, 0]
    y = axis[0, 1] + t * axis[1, 1] + half * axis[2, 1]
    z = axis[0, 2] + t * axis[1, 2] + half * axis[2, 2]
    dx = axis[1, 0] + t * axis[2, 0]
    dy = axis[1, 1] + t * axis[2, 1]
    dz = axis[1, 2] + t * axis[2, 2]
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return x, y, z, dx * scale, dy * scale, dz * scale


@compiled
def move_along(axis: Array, t: float, out: Array) -> None:
    """Fill the rows of the same axis with its origin moved along it to t, and unit direction."""
    x, y, z, dx, dy, dz = place_and_tangent(axis, t)
    out[0, 0], out[0, 1], out[0, 2] = x, y, z
    out[1, 0], out[1, 1], out[1, 2] = dx, dy, dz
    along = axis[2, 0] * dx + axis[2, 1] * dy + axis[2, 2] * dz
    for k in range(3):
        out[2, k] = axis[2, k] - along * out[1, k]


@compiled
def _step_to_point(
    axis: tuple[float, ...], px: float, py: float, pz: float, t: float
) -> tuple[float, float, float, float, float, float]:
    """Go from the place at t to the one nearest to a point on the tangent there.

    Returns:
        The step, m; the square of the distance between point and tangent, m²; the way from the
        place at t to the point, x y z, m; the place's new t.
    """
    half = 0.5 * t * t
    vx = px - axis[0] - t * axis[3] - half * axis[6]
    vy = py - axis[1] - t * axis[4] - half * axis[7]
    vz = pz - axis[2] - t * axis[5] - half * axis[8]
    # The tangent, of any length.
    dx, dy, dz = axis[3] + t * axis[6], axis[4] + t * axis[7], axis[5] + t * axis[8]
    along = vx * dx + vy * dy + vz * dz
    step = along / (dx * dx + dy * dy + dz * dz)
    return step, vx * vx + vy * vy + vz * vz - along * step, vx, vy, vz, t + step


@compiled
def nearest_to_points(axis: Array, points: Array, out: Array) -> None:
    """Find the places of an axis nearest to points.

    Without branches, so that the compiler takes several points at a time.

    Args:
        axis: see above.
        points: (3, N), the coordinates x, y and z, m.
        out: (5, N), filled with the distance, m; the way from that place to the point, x y z, m;
            t of the place, m.
    """
    numbers = _numbers(axis)
    x, y, z = points[0], points[1], points[2]
    distance, right, down, ahead, place = out[0], out[1], out[2], out[3], out[4]
    for i in range(x.shape[0]):
        _, _, _, _, _, t = _step_to_point(numbers, x[i], y[i], z[i], 0.0)
        _, _, _, _, _, t = _step_to_point(numbers, x[i], y[i], z[i], t)
        _, square, vx, vy, vz, _ = _step_to_point(numbers, x[i], y[i], z[i], t)
        distance[i] = np.sqrt(max(0.0, square))
        right[i], down[i], ahead[i] = vx, vy, vz
        place[i] = t


@compiled
def _numbers(axis: Array) -> tuple[float, ...]:
    return (
        axis[0, 0],
        axis[0, 1],
        axis[0, 2],
        axis[1, 0],
        axis[1, 1],
        axis[1, 2],
        axis[2, 0],
        axis[2, 1],
        axis[2, 2],
    )


@compiled
def nearest_to_rays(axis: Array, offset: float, rays: Array, out: Array) -> None:
    """Find the places of an axis nearest to rays of a camera, as ``nearest_to_ray`` does it.

    Without branches, so that the compiler takes several rays at a time.

    Args:
        axis, offset: see there.
        rays: (3, N), x, y and z of their unit directions.
        out: (3, N), filled with the distance, the depth and t of each.
    """
    numbers = _numbers(axis)
    x, y, z = rays[0], rays[1], rays[2]
    aside, depth, place = out[0], out[1], out[2]
    for i in range(x.shape[0]):
        step, _, _ = _step_to_ray(numbers, offset, x[i], y[i], z[i], 0.0)
        t = step
        step, _, _ = _step_to_ray(numbers, offset, x[i], y[i], z[i], t)
        t += step
        _, depth[i], aside[i] = _step_to_ray(numbers, offset, x[i], y[i], z[i], t)
        place[i] = t


@compiled
def _step_to_ray(
    axis: tuple[float, ...], offset: float, rx: float, ry: float, rz: float, t: float
) -> tuple[float, float, float]:
    """Go from the place at t to the one nearest to a ray on the tangent there.

    Returns:
        The step, m; the depth along the ray, m; the distance between ray and tangent, m, positive
        as ``nearest_to_ray`` has it.
    """
    half = 0.5 * t * t
    wx = axis[0] + t * axis[3] + half * axis[6] - offset
    wy = axis[1] + t * axis[4] + half * axis[7]
    wz = axis[2] + t * axis[5] + half * axis[8]
    # The tangent, of any length.
    dx, dy, dz = axis[3] + t * axis[6], axis[4] + t * axis[7], axis[5] + t * axis[8]
    square = dx * dx + dy * dy + dz * dz
    rd = rx * dx + ry * dy + rz * dz
    rw = rx * wx + ry * wy + rz * wz
    dw = dx * wx + dy * wy + dz * wz
    slope = 1.0 / max(_ALONG, square - rd * rd)
    mx, my, mz = ry * dz - rz * dy, rz * dx - rx * dz, rx * dy - ry * dx
    norm = max(_ALONG, np.sqrt(mx * mx + my * my + mz * mz))
    aside = -(wx * mx + wy * my + wz * mz) / norm
    return (rd * rw - dw) * slope, (square * rw - rd * dw) * slope, aside


@compiled
def nearest_to_ray(
    axis: Array, offset: float, rx: float, ry: float, rz: float
) -> tuple[float, float, float, float, float, float]:
    """Find the place of an axis nearest to a ray of a camera.

    Args:
        axis: see above.
        offset: x of the camera's centre, m; its y and z are 0.
        rx, ry, rz: unit direction of the ray.

    Returns:
        The distance, m, positive where the ray passes to the right of the axis as seen along
        travel; the depth along the ray, m; t of the place, m; the ray's cross product with the
        unit tangent there, x y z.
    """
    t = 0.0
    depth = 0.0
    wx = wy = wz = 0.0
    dx = dy = dz = 0.0
    square = 1.0
    for k in range(_STEPS + 1):
        half = 0.5 * t * t
        wx = axis[0, 0] + t * axis[1, 0] + half * axis[2, 0] - offset
        wy = axis[0, 1] + t * axis[1, 1] + half * axis[2, 1]
        wz = axis[0, 2] + t * axis[1, 2] + half * axis[2, 2]
        # The tangent, of any length.
        dx = axis[1, 0] + t * axis[2, 0]
        dy = axis[1, 1] + t * axis[2, 1]
        dz = axis[1, 2] + t * axis[2, 2]
        square = dx * dx + dy * dy + dz * dz
        rd = rx * dx + ry * dy + rz * dz
        rw = rx * wx + ry * wy + rz * wz
        dw = dx * wx + dy * wy + dz * wz
        slope = 1.0 / max(_ALONG, square - rd * rd)
        depth = (square * rw - rd * dw) * slope
        step = (rd * rw - dw) * slope
        if k == _STEPS or abs(step) < _STILL:
            break
        t += step
    scale = 1.0 / np.sqrt(square)
    mx = scale * (ry * dz - rz * dy)
    my = scale * (rz * dx - rx * dz)
    mz = scale * (rx * dy - ry * dx)
    norm = max(_ALONG, np.sqrt(mx * mx + my * my + mz * mz))
    return -(wx * mx + wy * my + wz * mz) / norm, depth, t, mx, my, mz
