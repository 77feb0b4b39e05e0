"""The truth of a frame: the stretch of axis in view and the pipe's visible contours.

Computed from the axis, never from the images or the meshes. The pipe is the surface at the radius
around the axis; a point of it is on the contour where the surface's normal, the radius, is square
to the line of sight. That holds for the bent pipe too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.raycaster import Caster

Array = NDArray[np.float64]

OUTSIDE, HIDDEN, VISIBLE = 0, 1, 2

# Spacing of contour points and of the centreline, m.
STEP = 0.05
# A contour grazes its own pipe; it is looked at from this far outside, m.
_CLEARANCE = 0.002
_NEAR = 0.05


@dataclass(frozen=True)
class Contours:
    """Visible contours of the pipe in one image.

    Attributes:
        chainage: (S,), m.
        points: (2, S, 3), m, in the camera's own optical frame; side 0 is left of travel.
        pixels: (2, S, 2) px; NaN behind the camera.
        flags: (2, S) uint8, OUTSIDE the image, HIDDEN by something before it, or VISIBLE (which
            does not promise contrast).
    """

    chainage: Array
    points: Array
    pixels: Array
    flags: NDArray[np.uint8]


def contour_points(axis: PipeAxis, s: Array, centre: Array) -> tuple[Array, Array]:
    """Find the contour points of sections of the pipe, seen from a camera.

    Args:
        axis: the pipe's axis.
        s: chainages (S,), m.
        centre: the camera's centre, (3,), world, m.

    Returns:
        Points (2, S, 3), side 0 left of travel, and their outward normals (2, S, 3), world; NaN
        where the camera lies inside the section's circle.
    """
    _, right, up = axis.frames(s)
    to_camera = centre - axis.points(s)
    a = np.sum(to_camera * right, axis=1)
    b = np.sum(to_camera * up, axis=1)
    # Radius n with n . (camera - axis) = r, n square to the axis: two angles off the camera's.
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.arccos(axis.radius / np.hypot(a, b))
    towards = np.arctan2(a, b)
    angles = np.stack([towards - off, towards + off])[..., None]
    normals = np.cos(angles) * up + np.sin(angles) * right
    return axis.points(s) + axis.radius * normals, normals


def frame_contours(
    axis: PipeAxis, caster: Caster, camera: Camera, pose: Pose, s: Array
) -> Contours:
    """Return the contours in one image.

    Args:
        axis: the pipe's axis.
        caster: the scene, for what hides the contours.
        camera: the camera.
        pose: world <- that camera's own optical frame.
        s: chainages to look at, (S,), m.
    """
    world, normals = contour_points(axis, s, pose.translation)
    points = pose.inverse().apply(world)
    depth = points[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        x = camera.fx * points[..., 0] / depth + camera.cx
        y = camera.fy * points[..., 1] / depth + camera.cy
        before = depth > _NEAR
        inside = before & (np.abs(x - (camera.width - 1) / 2.0) <= camera.width / 2.0)
        inside &= np.abs(y - (camera.height - 1) / 2.0) <= camera.height / 2.0
    pixels = np.where(before[..., None], np.stack([x, y], axis=-1), np.nan)
    flags = np.where(inside, VISIBLE, OUTSIDE).astype(np.uint8)
    ways = (world + _CLEARANCE * normals - pose.translation)[inside]
    origins = np.tile(pose.translation.astype(np.float32), (len(ways), 1))
    blocked = caster.blocked(origins, ways.astype(np.float32))
    flags[inside] = np.where(blocked, HIDDEN, VISIBLE)
    return Contours(s, points, pixels, flags)


def stretch_in_view(
    axis: PipeAxis, cameras: tuple[Camera, ...], poses: tuple[Pose, ...], margin: float = 1.0
) -> Array:
    """Return chainages (S,) in steps of STEP of what of the pipe may be in view of any camera.

    The pipe counts as in view where its axis or a contour falls into the image, whether hidden or
    not; the stretch is longer by ``margin`` at both ends, m. Empty where nothing is in view.
    """
    first = np.ceil(axis.start / STEP)
    s = STEP * np.arange(first, np.floor(axis.end / STEP) + 1)
    seen = np.zeros(len(s), bool)
    for camera, pose in zip(cameras, poses, strict=True):
        world = np.concatenate([contour_points(axis, s, pose.translation)[0], axis.points(s)[None]])
        points = pose.inverse().apply(world)
        with np.errstate(invalid="ignore", divide="ignore"):
            x = camera.fx * points[..., 0] / points[..., 2] + camera.cx
            y = camera.fy * points[..., 1] / points[..., 2] + camera.cy
            inside = (points[..., 2] > _NEAR) & (x >= -0.5) & (x <= camera.width - 0.5)
            inside &= (y >= -0.5) & (y <= camera.height - 0.5)
        seen |= inside.any(axis=0)
    found = np.flatnonzero(seen)
    if not len(found):
        return np.zeros(0)
    more = round(margin / STEP)
    return s[max(found[0] - more, 0) : found[-1] + more + 1]
