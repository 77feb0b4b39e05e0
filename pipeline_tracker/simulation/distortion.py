"""Lens distortion by the models that CameraInfo knows, and its inverse.

Coordinates are x and y of a direction at z = 1, without (sight) and with distortion. OpenCV's own
inverse has another signature, and another accuracy, in each of its versions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

_STEPS, _DIFFERENCE, _EXACT = 30, 1e-6, 1e-12


@compiled
def _polynomial(x: float, y: float, d: Array) -> tuple[float, float]:
    """Distort by plumb_bob or, with eight coefficients, rational_polynomial."""
    square = x * x + y * y
    radial = 1.0 + square * (d[0] + square * (d[1] + square * d[4]))
    if d.size > 5:
        radial /= 1.0 + square * (d[5] + square * (d[6] + square * d[7]))
    return (
        x * radial + 2.0 * d[2] * x * y + d[3] * (square + 2.0 * x * x),
        y * radial + d[2] * (square + 2.0 * y * y) + 2.0 * d[3] * x * y,
    )


@compiled
def _equidistant(x: float, y: float, d: Array) -> tuple[float, float]:
    """Distort by the fisheye's model: by the angle off the axis."""
    reach = np.sqrt(x * x + y * y)
    if reach < 1e-12:
        return x, y
    angle = np.arctan(reach)
    square = angle * angle
    bent = 1.0 + square * (d[0] + square * (d[1] + square * (d[2] + square * d[3])))
    scale = angle * bent / reach
    return x * scale, y * scale


@compiled
def _distorted(x: float, y: float, fisheye: bool, d: Array) -> tuple[float, float]:
    return _equidistant(x, y, d) if fisheye else _polynomial(x, y, d)


@compiled
def distort(sight: Array, fisheye: bool, coefficients: Array) -> Array:
    """Return distorted coordinates (N, 2).

    Args:
        sight: without distortion, (N, 2).
        fisheye: the model is ``equidistant``; else ``plumb_bob`` or ``rational_polynomial``.
        coefficients: D of that model.
    """
    result = np.empty_like(sight)
    for r in range(sight.shape[0]):
        result[r] = _distorted(sight[r, 0], sight[r, 1], fisheye, coefficients)
    return result


@compiled
def undistort(distorted: Array, fisheye: bool, coefficients: Array) -> Array:
    """Return coordinates (N, 2) without distortion; arguments as in ``distort``.

    Newton's method; where there is no solution its last step, which ``distort`` does not lead back.
    """
    result = np.empty_like(distorted)
    for r in range(distorted.shape[0]):
        goal_x, goal_y = distorted[r, 0], distorted[r, 1]
        x, y = goal_x, goal_y
        for _ in range(_STEPS):
            u, v = _distorted(x, y, fisheye, coefficients)
            off_x, off_y = u - goal_x, v - goal_y
            if off_x * off_x + off_y * off_y < _EXACT * _EXACT:
                break
            u_x, v_x = _distorted(x + _DIFFERENCE, y, fisheye, coefficients)
            u_y, v_y = _distorted(x, y + _DIFFERENCE, fisheye, coefficients)
            a, b = (u_x - u) / _DIFFERENCE, (u_y - u) / _DIFFERENCE
            c, d = (v_x - v) / _DIFFERENCE, (v_y - v) / _DIFFERENCE
            determinant = a * d - b * c
            if determinant == 0.0:
                break
            x -= (d * off_x - b * off_y) / determinant
            y -= (a * off_y - c * off_x) / determinant
        result[r, 0], result[r, 1] = x, y
    return result
