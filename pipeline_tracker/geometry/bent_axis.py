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
def nearest_to_point(
    axis: Array, px: float, py: float, pz: float
) -> tuple[float, float, float, float, float]:
    """Find the place of an axis nearest to a point.

    Args:
        axis: see above.
        px, py, pz: the point, m.

    Returns:
        The distance, m; the way from that place to the point, x y z, m; t of the place, m.
    """
    t = 0.0
    vx = vy = vz = 0.0
    square = 0.0
    for k in range(_STEPS + 1):
        half = 0.5 * t * t
        vx = px - axis[0, 0] - t * axis[1, 0] - half * axis[2, 0]
        vy = py - axis[0, 1] - t * axis[1, 1] - half * axis[2, 1]
        vz = pz - axis[0, 2] - t * axis[1, 2] - half * axis[2, 2]
        # The tangent, of any length.
        dx = axis[1, 0] + t * axis[2, 0]
        dy = axis[1, 1] + t * axis[2, 1]
        dz = axis[1, 2] + t * axis[2, 2]
        along = vx * dx + vy * dy + vz * dz
        step = along / (dx * dx + dy * dy + dz * dz)
        square = vx * vx + vy * vy + vz * vz - along * step
        if k == _STEPS or abs(step) < _STILL:
            break
        t += step
    return np.sqrt(max(0.0, square)), vx, vy, vz, t


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
