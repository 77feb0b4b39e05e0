"""The paper's three techniques for the axis of a pipe seen by its contours (4.2.4).

All coordinates are in the left optical frame; lines are homogeneous (a, b, c) in pixels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]

# Technique 3 is refused where the two median planes meet at less than this, rad: at 2 m and a
# baseline of 0.2 m, a pipe less than 30 degrees from the baseline.
LEAST_PLANE_ANGLE = 0.045
# Tangent planes that meet at less than this are one plane.
_PARALLEL = 1e-6


def tangent_plane(line: Array, camera: Camera) -> Array:
    """Return the unit normal of the plane through the camera's centre and an image line, (3,)."""
    normal = camera.matrix.T @ line
    unit: Array = normal / np.linalg.norm(normal)
    return unit


def oriented_planes(left: Array, right: Array, camera: Camera) -> tuple[Array, Array] | None:
    """Return the normals of both tangent planes, pointing the same way across the pipe.

    Args:
        left, right: the two contour lines.
        camera: the camera.

    Returns:
        None where the lines have no strip between them inside the picture.
    """
    planes = np.empty((2, 3))
    return (planes[0], planes[1]) if _orient(left, right, camera.numbers, planes) else None


@compiled
def _orient(left: Array, right: Array, camera: Array, planes: Array) -> bool:
    """Fill both normals, (2, 3), see ``oriented_planes``; whether there is a strip."""
    inside = np.empty(2)
    if not _fill_between(left, right, camera[4], camera[5], inside):
        return False
    for k in range(2):
        line = left if k == 0 else right
        # Opposite signs at a pixel between them: both normals point to the same side, across the
        # pipe.
        value = line[0] * inside[0] + line[1] * inside[1] + line[2]
        sign = -1.0 if (value > 0.0 if k == 0 else value < 0.0) else 1.0
        x, y = line[0] * camera[0], line[1] * camera[1]
        z = line[0] * camera[2] + line[1] * camera[3] + line[2]
        scale = sign / np.sqrt(x * x + y * y + z * z)
        planes[k, 0], planes[k, 1], planes[k, 2] = x * scale, y * scale, z * scale
    return True


def technique2(
    left: Array, right: Array, camera: Camera, radius: float, seen: Array | None = None
) -> Axis | None:
    """Technique 2: tangent planes of one image.

    Args:
        left, right: the two contours of the pipe in that image.
        camera: the camera.
        radius: m.
        seen: a pixel between them where the pipe is seen, (2,), for a camera that looks so far
            forward that the contours meet in the picture; None: midway between the lines.

    Returns:
        The axis, or None where the lines are no contours of a pipe before the camera.
    """
    pixel = np.full(2, np.nan) if seen is None else seen
    rows = np.empty((2, 3))
    if not _solve_tangents(left, right, camera.numbers, radius, pixel, rows):
        return None
    return Axis.straight(rows[0], rows[1])


@compiled
def _solve_tangents(
    left: Array, right: Array, camera: Array, radius: float, seen: Array, axis: Array
) -> bool:
    """Fill point and direction of the axis, (2, 3), see ``technique2``; whether there is one.

    Args:
        left, right, radius: see there.
        camera: its numbers.
        seen: a pixel between the lines; NaN: midway between them.
        axis: filled.
    """
    planes = np.empty((2, 3))
    if not _orient(left, right, camera, planes):
        return False
    n_left, n_right = planes[0], planes[1]
    v = np.cross(n_left, n_right)
    sine = np.sqrt(np.sum(v * v))
    if sine < _PARALLEL:
        return False
    v /= sine
    n_median = n_left + n_right
    n_median /= np.sqrt(np.sum(n_median * n_median))
    beta = np.arctan2(sine, np.sum(n_left * n_right))
    distance = radius / np.sin(beta / 2.0)
    inside = seen.copy()
    if np.isnan(seen[0]):
        _fill_between(left, right, camera[4], camera[5], inside)
    u = np.cross(v, n_median)
    # The sign for which the visible part of the axis lies before the camera: the axis and the ray
    # of a pixel on it in the picture are on the same side of v.
    ray = np.array([(inside[0] - camera[2]) / camera[0], (inside[1] - camera[3]) / camera[1], 1.0])
    across = ray - v * np.sum(ray * v)
    if np.sum(u * across) < 0.0:
        u = -u
    axis[0] = distance * u
    axis[0, 0] += camera[6]
    axis[1] = v
    return True


def technique3(
    left_pair: tuple[Array, Array],
    right_pair: tuple[Array, Array],
    rig: StereoRig,
    least_angle: float = LEAST_PLANE_ANGLE,
) -> Axis | None:
    """Technique 3: where the median planes of both images meet.

    Args:
        left_pair, right_pair: the contours (left, right) in the left and the right image.
        rig: the two cameras.
        least_angle: refused where the planes meet at less than this, rad.
    """
    if rig.right is None:
        return None
    medians = []
    for pair, camera in ((left_pair, rig.left), (right_pair, rig.right)):
        normals = oriented_planes(pair[0], pair[1], camera)
        if normals is None:
            return None
        median = normals[0] + normals[1]
        medians.append(median / np.linalg.norm(median))
    v = np.cross(medians[0], medians[1])
    sine = float(np.linalg.norm(v))
    if sine < np.sin(least_angle):
        return None
    v = v / sine
    # A point of both planes, and across the axis from the left camera's centre.
    system = np.stack((medians[0], medians[1], v))
    point = np.linalg.solve(system, np.array([0.0, float(medians[1] @ rig.right.centre), 0.0]))
    if point[2] <= 0 and abs(v[2]) < 1e-9:
        return None
    return Axis.straight(point, v)


def technique1(
    points: Array, sigmas: Array, direction: Array, radius: float, vertical: Array
) -> Axis | None:
    """Technique 1: the axis from surface points and a direction known from a contour.

    Least squares of the points' distance from the axis in the plane across it, robust against
    points on the bed or on fouling.

    Args:
        points: surface points, (N, 3), m, N >= 3.
        sigmas: standard deviations of their distance, (N,), m.
        direction: direction of the axis, (3,).
        radius: m.
        vertical: unit vector up, (3,).
    """
    if points.shape[0] < 3:
        return None
    y = direction / np.linalg.norm(direction)
    z = vertical - y * float(vertical @ y)
    if np.linalg.norm(z) < 1e-6:
        z = np.cross(y, np.array([1.0, 0.0, 0.0]))
    z = z / np.linalg.norm(z)
    x = np.cross(y, z)
    plane = np.stack((points @ x, points @ z), axis=1)
    # The points' mean moved by r away from the camera, or squarely off the plane through them:
    # there is a second minimum on the camera's side, and either start may fall into it.
    mean = np.median(points, axis=0)
    away = mean - y * float(mean @ y)
    away = away / np.linalg.norm(away)
    middle, across = np.array([mean @ x, mean @ z]), np.array([away @ x, away @ z])
    _, vectors = np.linalg.eigh(np.cov(plane.T))
    square = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ across) >= 0 else -1.0)
    # And the circle of any radius through them, which is linear in its unknowns.
    design = np.column_stack((2.0 * plane, np.ones(len(plane))))
    circle = np.linalg.lstsq(design, np.square(plane).sum(axis=1), rcond=None)[0][:2]
    starts = [circle, middle + radius * across, middle + radius * square]

    def residual(place: Array) -> Array:
        away_from = np.hypot(plane[:, 0] - place[0], plane[:, 1] - place[1])
        distance: Array = (away_from - radius) / sigmas
        return distance

    # From wide to narrow: a narrow fit from so rough a start often ends in that second minimum.
    best = np.inf
    centre = starts[0]
    for start in starts:
        place = start
        for width in (20.0, 6.0, 2.0):
            fit = least_squares(residual, place, loss="cauchy", f_scale=width)
            place = fit.x
        if float(fit.cost) < best:
            best, centre = float(fit.cost), place
    along = float(np.median(points @ y))
    return Axis.straight(centre[0] * x + centre[1] * z + along * y, y)


@compiled
def _fill_between(left: Array, right: Array, width: float, height: float, pixel: Array) -> bool:
    """Fill a pixel midway between two lines; whether either of them enters the picture."""
    ends = np.empty(4)
    # From the middle of one clipped line to the nearest place of the other.
    if _clip(left, width, height, ends):
        other = right
    elif _clip(right, width, height, ends):
        other = left
    else:
        return False
    x, y = 0.5 * (ends[0] + ends[2]), 0.5 * (ends[1] + ends[3])
    off = other[0] * x + other[1] * y + other[2]
    pixel[0] = x - 0.5 * off * other[0]
    pixel[1] = y - 0.5 * off * other[1]
    return True


@compiled
def _clip(line: Array, width: float, height: float, ends: Array) -> bool:
    """Fill the ends of a line clipped to the picture; whether it enters it."""
    a, b, c = line[0], line[1], line[2]
    low, high = -np.inf, np.inf
    for k in range(2):
        point, step, size = (-a * c, -b, width) if k == 0 else (-b * c, a, height)
        if abs(step) < 1e-12:
            if not -0.5 <= point <= size - 0.5:
                return False
            continue
        first, second = (-0.5 - point) / step, (size - 0.5 - point) / step
        low, high = max(low, min(first, second)), min(high, max(first, second))
    if not low < high:
        return False
    ends[0], ends[1] = -a * c - low * b, -b * c + low * a
    ends[2], ends[3] = -a * c - high * b, -b * c + high * a
    return True


def clip_image_line(line: Array, width: int, height: int) -> Array | None:
    """Clip an image line to the picture; (4,) x1 y1 x2 y2, px, or None where it misses it."""
    ends = np.empty(4)
    return ends if _clip(line, width, height, ends) else None
