"""From a fitted axis to the published piece of it, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.acceptance import support_share
from pipeline_tracker.axis_fit import Axis, AxisFit, across
from pipeline_tracker.geometry.bent_axis import place_and_tangent
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import NEAR, clip_line_to_view, clip_to_view
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.jit import compiled
from pipeline_tracker.settings import Settings
from pipeline_tracker.support import Support, seen_lines
from pipeline_tracker.types import Mode, PipeSegment, VectorizedStereo

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])

# What no residual shows: calibration, the shape of a real pipe, edges that are not its contour.
# Standard deviations of left and up for each metre of distance, of heading and pitch in rad; added
# to those of the fit.
_MODEL_SIGMAS = np.array([0.0001, 0.00015, 0.001, 0.001])
# Patches overlap and share their particles and their haze: they err more alike than the fit
# assumes. By rendered seas, its variances are so many times larger where there is a surface.
_ALIKE = 1.5
# What lies on a part of the face (silt, growth) lifts and tilts the fit: standard deviations for
# each unit of the share that is missing.
_WHOLE_FACE = 0.85
_COVERED_SIGMAS = np.array([0.005, 0.02, 0.01, 0.02])


@compiled
def _middle_of_view(axis: Array, camera: Array) -> float:
    t = 0.0
    point, direction = np.empty(3), np.empty(3)
    for _ in range(8):
        for k in range(3):
            point[k] = axis[0, k] + t * axis[1, k] + 0.5 * t * t * axis[2, k]
            direction[k] = axis[1, k] + t * axis[2, k]
        slope = point[0] * direction[0] + point[1] * direction[1]
        curvature = direction[0] ** 2 + direction[1] ** 2
        curvature += point[0] * axis[2, 0] + point[1] * axis[2, 1]
        if curvature < 1e-9:
            break
        step = min(max(slope / curvature, -2.0), 2.0)
        t -= step
        if abs(step) < 1e-9:
            break
    x, y, z, dx, dy, dz = place_and_tangent(axis, t)
    here, ahead = np.array([x, y, z]), np.array([dx, dy, dz])
    low, high = clip_to_view(here, ahead, camera, NEAR, 0.0, -np.inf, np.inf)
    if low < high:
        t += min(max(0.0, low), high)
    return t


def middle_of_view(axis: Axis, camera: Camera) -> float:
    """Return t where the axis passes nearest the camera's optical axis, kept inside the view.

    Args:
        axis: left optical frame.
        camera: the left camera.
    """
    return _middle_of_view(axis.rows, camera.numbers)


def segment_ends(axis: Axis, camera: Camera, length: float) -> tuple[Array, Array]:
    """Return both ends of the published piece of an axis whose origin is its middle.

    Args:
        axis: left optical frame; t = 0 as ``middle_of_view`` gives it.
        camera: the left camera.
        length: wanted length, m; less where less is in view.

    Returns:
        Start and end, (3,) each, on the bent axis.
    """
    low, high = -0.5 * length, 0.5 * length
    view = clip_line_to_view(axis.point, axis.direction, camera)
    if view is not None:
        clipped = max(low, view[0]), min(high, view[1])
        # A sliver has no direction; then the piece reaches out of view.
        if clipped[1] - clipped[0] > 0.1 * length:
            low, high = clipped
    return axis.at(low), axis.at(high)


def published_covariance(fit: AxisFit, support: Support) -> Array:
    """Return the 4 x 4 covariance (left, up, heading, pitch) of a fit at its origin.

    Args:
        fit: the fit.
        support: what the pictures have for it.
    """
    distance = max(1.0, float(np.linalg.norm(fit.axis.point)))
    sigmas = _MODEL_SIGMAS * np.array([distance, distance, 1.0, 1.0])
    alike = _ALIKE if support.face_points else 1.0
    covariance: Array = alike * fit.covariance[:4, :4] + np.diag(np.square(sigmas))
    if support.face_points:
        covered = max(0.0, _WHOLE_FACE - support.face_share)
        covariance += np.diag(np.square(covered * _COVERED_SIGMAS))
    return 0.5 * (covariance + covariance.T)


class SegmentMaker:
    """Publishes pieces of the axis of one pipe seen by one vehicle."""

    def __init__(self, settings: Settings, mounting: Pose) -> None:
        """Remember what all segments share.

        Args:
            settings: the pipe's radius and ``segment.length`` are used.
            mounting: base_link <- left optical.
        """
        self._radius = settings.radius
        self._length = settings.segment.length
        self._mounting = mounting

    def make(
        self,
        frame: VectorizedStereo,
        axis: Axis,
        covariance: Array,
        support: Support,
        mode: Mode,
        technique: int,
    ) -> PipeSegment:
        """Publish the piece of an axis in the middle of the view.

        Args:
            frame: the vectorized pair.
            axis: left optical frame, origin at the middle of the piece, along travel.
            covariance: 4 x 4, see ``PipeSegment``.
            support: what the pictures have for it.
            mode: recognition or tracking.
            technique: 0 tracking, 1 to 4.
        """
        start, end = segment_ends(axis, frame.rig.left, self._length)
        bits, lines = seen_lines(support)
        return PipeSegment(
            stamp_ns=frame.stamp_ns,
            mode=mode,
            technique=technique,
            start=self._mounting.apply(start),
            end=self._mounting.apply(end),
            radius=self._radius,
            covariance=covariance + _sag(axis, start, end, self._mounting),
            support=float(np.float32(support_share(support))),
            visible_contours=bits,
            contours=lines,
        )


def _sag(axis: Axis, start: Array, end: Array, mounting: Pose) -> Array:
    """Return what the bend adds to the 4 x 4 covariance of a straight piece at its middle."""
    left, up = across(mounting.rotate(axis.direction), _UP)
    off = mounting.rotate(axis.point - 0.5 * (start + end))
    return np.diag([float(off @ left) ** 2, float(off @ up) ** 2, 0.0, 0.0])


def axis_of_segment(segment: PipeSegment, mounting: Pose) -> Axis:
    """Return the straight axis through a published piece, left optical frame, origin mid-way."""
    to_optical = mounting.inverse()
    start, end = to_optical.apply(segment.start), to_optical.apply(segment.end)
    return Axis.straight(0.5 * (start + end), end - start)


def turn_covariance(covariance: Array, direction: Array, old_up: Array, new_up: Array) -> Array:
    """Express a 4 x 4 axis covariance for another vertical.

    Args:
        covariance: left, up, heading, pitch.
        direction: unit direction of the axis, (3,).
        old_up, new_up: the unit verticals, (3,), in the same frame.
    """
    old_left, old_across = across(direction, old_up)
    new_left, _ = across(direction, new_up)
    c, s = float(new_left @ old_left), float(new_left @ old_across)
    turn = np.array([[c, s], [-s, c]])
    both = np.zeros((4, 4))
    both[:2, :2] = turn
    both[2:, 2:] = turn
    return both @ covariance @ both.T
