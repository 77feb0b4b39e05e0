"""Visible boundaries of a cylinder, and the axis from what is seen of it (4.1.2, 4.2.4).

Points and directions are in the left camera's optical frame unless said otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera

Array = NDArray[np.float64]


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


def clip_line_to_view(
    point: Array, direction: Array, camera: Camera, near: float = 0.05, margin: float = 0.0
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
    p = point - camera.centre
    low, high = -np.inf, np.inf
    x0, x1 = margin - 0.5, camera.width - 0.5 - margin
    y0, y1 = margin - 0.5, camera.height - 0.5 - margin
    # Each border of the view is a half space n·X >= 0 through the camera's centre.
    planes = np.array(
        [
            [camera.fx, 0.0, camera.cx - x0],
            [-camera.fx, 0.0, x1 - camera.cx],
            [0.0, camera.fy, camera.cy - y0],
            [0.0, -camera.fy, y1 - camera.cy],
            [0.0, 0.0, 1.0],
        ]
    )
    values = planes @ p
    values[4] -= near
    slopes = planes @ direction
    for value, slope in zip(values, slopes, strict=True):
        if abs(slope) < 1e-12:
            if value < 0.0:
                return None
            continue
        bound = -value / slope
        if slope > 0.0:
            low = max(low, bound)
        else:
            high = min(high, bound)
    return (float(low), float(high)) if low < high else None
