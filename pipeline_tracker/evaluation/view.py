"""What of the true pipe an image has in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.evaluation.contours import OUTSIDE, VISIBLE, TrueContours
from pipeline_tracker.evaluation.truth import Truth
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose

Array = NDArray[np.float64]

# Sections of the pipe are looked at so far apart, m.
_STEP = 0.05
_NEAR = 0.05
# Nothing is seen through so much water, m.
_FAR = 50.0


@dataclass(frozen=True)
class View:
    """What of the true pipe a frame has in view.

    Attributes:
        in_view: whether any of it is inside an image, hidden or not; None without the cameras.
        detectable: whether, in the left image, of one contour's length in view at least a quarter
            is not hidden; None where that is not known.
    """

    in_view: bool | None
    detectable: bool | None


def pipe_in_view(truth: Truth, stamp: int, pose: Pose, radius: float) -> View:
    """Find what of the pipe a frame has in view.

    What is in view is computed from the geometry; what is hidden of it only the bag can tell.

    Args:
        truth: the truth.
        stamp: of the frame, ns.
        pose: world <- base_link.
        radius: the pipe's, m.
    """
    if truth.axis.empty:
        return View(in_view=False, detectable=False)
    told = None if truth.detectable is None else truth.detectable.get(stamp)
    if truth.rig is None or truth.mounting is None:
        return View(in_view=None, detectable=told)
    to_camera = (pose @ truth.mounting).inverse()
    parts = [sections(line) for line in truth.near(stamp)]
    points = np.concatenate([to_camera.apply(p) for p, _ in parts])
    tangents = np.concatenate([to_camera.rotate(t) for _, t in parts])
    seen = [contours_in_view(points, tangents, radius, camera) for camera in truth.rig.cameras]
    return View(in_view=any(bool(s.any()) for s in seen), detectable=told)


def sections(polyline: Array) -> tuple[Array, Array]:
    """Divide a polyline into sections.

    Args:
        polyline: (M, 3), m.

    Returns:
        Points (S, 3), m, about 5 cm apart, and unit tangents (S, 3).
    """
    ways = np.diff(polyline, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    keep = lengths > 0.0
    starts, ways, lengths = polyline[:-1][keep], ways[keep], lengths[keep]
    if not len(ways):
        return np.zeros((0, 3)), np.zeros((0, 3))
    counts = np.maximum(1, np.ceil(lengths / _STEP)).astype(int)
    piece = np.repeat(np.arange(len(ways)), counts)
    number = np.concatenate([np.arange(c) for c in counts])
    points = starts[piece] + (number / counts[piece])[:, None] * ways[piece]
    points = np.concatenate((points, polyline[-1:]))
    tangents = ways / lengths[:, None]
    return points, np.concatenate((tangents[piece], tangents[-1:]))


def contour_points(
    points: Array, tangents: Array, radius: float, camera: Camera
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the pipe's two contours as a camera sees them, section by section.

    The contour of a bent pipe: where the surface's normal is square to the line of sight.

    Args:
        points, tangents: sections of the axis in the left optical frame, (S, 3).
        radius: m.
        camera: the camera.

    Returns:
        Points (2, S, 3) in the left optical frame, m, side 0 left of the tangent, and for each
        section whether the camera is outside its circle; without that there is no contour.
    """
    to_camera = camera.centre - points
    aside = to_camera - np.sum(to_camera * tangents, axis=1)[:, None] * tangents
    distance = np.linalg.norm(aside, axis=1)
    outside = distance > radius
    safe = np.where(outside, distance, 2.0 * radius)[:, None]
    e1 = aside / safe
    e2 = np.cross(tangents, e1)
    near = radius**2 / safe * e1
    across = radius * np.sqrt(np.maximum(0.0, 1.0 - (radius / safe) ** 2)) * e2
    return np.stack([points + near + sign * across for sign in (-1.0, 1.0)]), outside


def contours_in_view(points: Array, tangents: Array, radius: float, camera: Camera) -> Array:
    """Find which sections of the pipe's two contours, and of its axis, are inside an image.

    Args:
        points, tangents, radius, camera: see ``contour_points``.

    Returns:
        (3, S) bool: left contour, right contour, axis.
    """
    contours, outside = contour_points(points, tangents, radius, camera)
    seen = [_inside(contour, camera) & outside for contour in contours]
    return np.stack([*seen, _inside(points, camera)])


def true_contours(
    truth: Truth, stamp: int, pose: Pose, radius: float, image: int
) -> TrueContours | None:
    """Return the true contours in an image: as the bag tells them, else computed from the axis.

    Args:
        truth: the truth.
        stamp: of the frame, ns.
        pose: world <- base_link.
        radius: the pipe's, m.
        image: 0 left, 1 right.

    Returns:
        The contours; None where they are not known: the bag has no cameras.
    """
    told = truth.contours[image].get(stamp)
    if told is not None:
        return told
    if truth.rig is None or truth.mounting is None or image >= len(truth.rig.cameras):
        return None
    camera, to_camera = truth.rig.cameras[image], (pose @ truth.mounting).inverse()
    pixels, inside = [], []
    gap = np.full((2, 1, 2), np.nan)
    for line in truth.near(stamp):
        points, tangents = sections(line)
        contours, outside = contour_points(
            to_camera.apply(points), to_camera.rotate(tangents), radius, camera
        )
        before = outside & (contours[..., 2] > _NEAR)
        shown = camera.project(np.where(before[..., None], contours, [0.0, 0.0, 1.0]))
        pixels += [np.where(before[..., None], shown, np.nan), gap]
        seen = np.stack([_inside(contour, camera) & outside for contour in contours])
        inside += [seen, np.zeros((2, 1), bool)]
    if not pixels:
        return TrueContours(np.zeros((2, 0, 2)), np.zeros((2, 0), np.int64), hidden_known=False)
    flags = np.where(np.concatenate(inside, axis=1), VISIBLE, OUTSIDE)
    return TrueContours(np.concatenate(pixels, axis=1), flags, hidden_known=False)


def _inside(points: Array, camera: Camera) -> NDArray[np.bool_]:
    before = (points[:, 2] > _NEAR) & (np.linalg.norm(points, axis=1) < _FAR)
    pixels = camera.project(np.where(before[:, None], points, [0.0, 0.0, 1.0]))
    x, y = pixels[:, 0], pixels[:, 1]
    inside: NDArray[np.bool_] = (
        before & (x >= -0.5) & (x <= camera.width - 0.5) & (y >= -0.5) & (y <= camera.height - 0.5)
    )
    return inside
