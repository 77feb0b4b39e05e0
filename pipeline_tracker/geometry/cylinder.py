"""Visible boundaries of a cylinder, and the axis from what is seen of it (4.1.2, 4.2.4).

Points and directions are in the left camera's optical frame unless said otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

# Least depth before a camera, m, and the slope below which a line runs along a border of the view.
NEAR = 0.05
_PARALLEL = 1e-12


def nearest_point(point: Array, direction: Array, origin: Array) -> Array:
    """Return the point of the line ``point + t * direction`` nearest to ``origin``, (3,), m."""
    unit = direction / np.linalg.norm(direction)
    nearest: Array = point + unit * float(np.dot(origin - point, unit))
    return nearest


def visible_generatrices(
    point: Array, direction: Array, radius: float, centre: Array
) -> tuple[Array, Array] | None:
    """Find the two lines in which a camera sees the edge of a cylinder (4.1.2, Fig. 3).

    Args:
        point: a point of the axis, (3,), m.
        direction: direction of the axis along travel, (3,).
        radius: radius of the cylinder, m.
        centre: the camera's centre, (3,), m.

    Returns:
        A point of the left and of the right visible generatrix (both parallel to the axis), in the
        section through the axis point nearest to the camera; left and right as seen along
        ``direction`` with the camera above. None where the camera is inside the cylinder.
    """
    unit = direction / np.linalg.norm(direction)
    q = nearest_point(point, unit, centre) - centre
    distance = float(np.linalg.norm(q))
    if not distance > radius:
        return None
    e1 = -q / distance
    e2 = np.cross(unit, e1)
    near = radius * radius / distance * e1
    aside = radius * np.sqrt(distance * distance - radius * radius) / distance * e2
    return centre + q + near - aside, centre + q + near + aside


def contour_lines(
    point: Array, direction: Array, radius: float, camera: Camera
) -> tuple[Array, Array] | None:
    """Project the visible boundaries into an image as homogeneous lines (4.1.2).

    Returns:
        Left and right contour, each (a, b, c) with a² + b² = 1 and a x + b y + c = 0 in pixels;
        None where the camera is inside the cylinder or a line has no direction in the image
        (the camera looks along it).
    """
    edges = visible_generatrices(point, direction, radius, camera.centre)
    if edges is None:
        return None
    inverse = np.linalg.inv(camera.matrix)
    lines: list[Array] = []
    for edge in edges:
        line = inverse.T @ np.cross(edge - camera.centre, direction)
        norm = float(np.hypot(line[0], line[1]))
        if not norm > 0.0:
            return None
        lines.append(line / norm)
    return lines[0], lines[1]


@compiled
def clip_to_view(
    point: Array,
    direction: Array,
    camera: Array,
    near: float,
    margin: float,
    low: float,
    high: float,
) -> tuple[float, float]:
    """Clip a piece of a line in space to what a camera has in view, compiled.

    Args:
        point: a point of the line, (3,), m.
        direction: direction of the line, (3,).
        camera: the camera's numbers.
        near: least depth before the camera, m.
        margin: px by which the image is shrunk (positive) or grown (negative).
        low, high: the piece, from ``point + low * direction`` to ``point + high * direction``.

    Returns:
        What of it is in view; nothing where the first is not below the second.
    """
    start = (point[0] - camera[6], point[1], point[2])
    way = (direction[0], direction[1], direction[2])
    return _clip(start, way, camera, near, margin, low, high)


@compiled
def _clip(
    start: tuple[float, float, float],
    way: tuple[float, float, float],
    camera: Array,
    near: float,
    margin: float,
    low: float,
    high: float,
) -> tuple[float, float]:
    """Clip a line, see ``clip_to_view``; its point is given from the camera's centre."""
    x, y, z = start
    dx, dy, dz = way
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    right, bottom = camera[4] - 0.5 - margin, camera[5] - 0.5 - margin
    # Each border of the view is a half space n·X >= 0 through the camera's centre.
    for k in range(5):
        if k == 0:
            value = fx * x + (cx - margin + 0.5) * z
            slope = fx * dx + (cx - margin + 0.5) * dz
        elif k == 1:
            value = (right - cx) * z - fx * x
            slope = (right - cx) * dz - fx * dx
        elif k == 2:
            value = fy * y + (cy - margin + 0.5) * z
            slope = fy * dy + (cy - margin + 0.5) * dz
        elif k == 3:
            value = (bottom - cy) * z - fy * y
            slope = (bottom - cy) * dz - fy * dy
        else:
            value = z - near
            slope = dz
        if abs(slope) < _PARALLEL:
            if value < 0.0:
                return low, low
            continue
        bound = -value / slope
        if slope > 0.0:
            low = max(low, bound)
        else:
            high = min(high, bound)
    return low, high


def clip_line_to_view(
    point: Array, direction: Array, camera: Camera, near: float = NEAR, margin: float = 0.0
) -> tuple[float, float] | None:
    """Clip a line in space to what a camera has in view.

    Args:
        point: a point of the line, (3,), m.
        direction: unit direction of the line, (3,).
        camera: the camera.
        near: least depth before the camera, m.
        margin: px by which the image is shrunk (positive) or grown (negative).

    Returns:
        Range (t0, t1), t0 < t1, of ``point + t * direction`` in view; None where nothing is.
        An end is infinite where the line reaches its vanishing point inside the image.
    """
    low, high = clip_to_view(point, direction, camera.numbers, near, margin, -np.inf, np.inf)
    return (low, high) if low < high else None


@compiled
def boundary_in_view(
    point: Array,
    direction: Array,
    radius: float,
    side: float,
    camera: Array,
    low: float,
    high: float,
    line: Array,
) -> bool:
    """Project a piece of one visible boundary of a straight pipe (4.1.2), compiled.

    Args:
        point: a point of the axis, (3,), m.
        direction: its unit direction, (3,).
        radius: m.
        side: -1 for the left boundary, +1 for the right, see ``visible_generatrices``.
        camera: the camera's numbers.
        low, high: the piece, counted from the section through ``point``, m.
        line: (4,), filled with x1 y1 x2 y2, px.

    Returns:
        Whether anything of it is in view; the camera inside the pipe sees nothing.
    """
    cx, cy, cz = point[0] - camera[6], point[1], point[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    along = cx * dx + cy * dy + cz * dz
    qx, qy, qz = cx - along * dx, cy - along * dy, cz - along * dz
    square = qx * qx + qy * qy + qz * qz
    if not square > radius * radius:
        return False
    near = -radius * radius / square
    aside = -side * radius * np.sqrt(square - radius * radius) / square
    # The boundary's place in the section, from the camera.
    x = cx + near * qx + aside * (dy * qz - dz * qy)
    y = cy + near * qy + aside * (dz * qx - dx * qz)
    z = cz + near * qz + aside * (dx * qy - dy * qx)
    low, high = _clip((x, y, z), (dx, dy, dz), camera, NEAR, 0.0, low, high)
    if not low < high:
        return False
    for k in range(2):
        t = low if k == 0 else high
        depth = z + t * dz
        line[2 * k] = camera[0] * (x + t * dx) / depth + camera[2]
        line[2 * k + 1] = camera[1] * (y + t * dy) / depth + camera[3]
    return True
