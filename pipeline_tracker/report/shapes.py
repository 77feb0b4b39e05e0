"""What is drawn of a frame in an image, as points in pixels: contours, axis, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import across
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import (
    clip_line_to_view,
    contour_lines,
    visible_generatrices,
)
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import Contours, PipeSegment

Array = NDArray[np.float64]

# Half the width of a 95 % band of a normal distribution, in standard deviations.
_BAND = 1.96
_SAMPLES = 24
# Less than this before the camera nothing is projected; further along the pipe than that nothing
# is drawn, m.
_NEAR = 0.05
_FAR = 30.0
_VERTICAL = np.array([0.0, 0.0, 1.0])
_BITS = (
    (Contours.LEFT_IMAGE_LEFT, Contours.LEFT_IMAGE_RIGHT),
    (Contours.RIGHT_IMAGE_LEFT, Contours.RIGHT_IMAGE_RIGHT),
)


@dataclass(frozen=True)
class ContourShape:
    """One side of the pipe in one image; pixel centres are at integers.

    Attributes:
        is_left: whether it is the left side, seen along travel.
        seen: (2, 2) px, the contour that was found; None where it was not.
        expected: (2, 2) px, where the published axis and radius put it; None out of view.
        band: (2 N, 2) px, polygon in which it lies with 95 %; None where that is not known.
    """

    is_left: bool
    seen: Array | None
    expected: Array | None
    band: Array | None


@dataclass(frozen=True)
class FrameShapes:
    """What is drawn of a segment in one image.

    Attributes:
        contours: left and right side of the pipe.
        axis: (2, 2) px, the published piece from start to end; None behind the camera.
    """

    contours: tuple[ContourShape, ContourShape]
    axis: Array | None

    def scaled(self, scale: float) -> FrameShapes:
        """Return the same in an image made smaller."""
        left, right = (
            ContourShape(
                contour.is_left,
                _scaled_if(contour.seen, scale),
                _scaled_if(contour.expected, scale),
                _scaled_if(contour.band, scale),
            )
            for contour in self.contours
        )
        return FrameShapes((left, right), _scaled_if(self.axis, scale))


def scaled(points: Array, scale: float) -> Array:
    """Return points (..., 2), px, in an image made smaller; pixel centres stay at integers."""
    return (points + 0.5) * scale - 0.5


def frame_shapes(
    segment: PipeSegment, camera: Camera, image: int, mounting: Pose | None
) -> FrameShapes:
    """Return what is drawn of a segment in an image.

    Args:
        segment: found, or carried on by the pose.
        camera: the image's camera.
        image: 0 left, 1 right.
        mounting: base_link <- left optical frame; None: not known, and so is all but the contours
            that were seen.
    """
    seen = _seen(segment)
    if mounting is None:
        left, right = (
            ContourShape(is_left, seen.get(bit), None, None)
            for bit, is_left in zip(_BITS[image], (True, False), strict=True)
        )
        return FrameShapes((left, right), None)
    expected = _expected(segment, camera, mounting)
    left, right = (
        ContourShape(is_left, seen.get(bit), *side)
        for bit, is_left, side in zip(_BITS[image], (True, False), expected, strict=True)
    )
    ends = mounting.inverse().apply(np.stack((segment.start, segment.end)))
    has_axis = (ends[:, 2] >= _NEAR).all() and not np.array_equal(segment.start, segment.end)
    return FrameShapes((left, right), camera.project(ends) if has_axis else None)


def _scaled_if(points: Array | None, scale: float) -> Array | None:
    return None if points is None else scaled(points, scale)


def _seen(segment: PipeSegment) -> dict[Contours, Array]:
    bits = [bit for bit in Contours if bit and bit in segment.visible_contours]
    lines = segment.contours.astype(np.float64).reshape(-1, 2, 2)
    return dict(zip(bits, lines, strict=False))


def _expected(
    segment: PipeSegment, camera: Camera, mounting: Pose
) -> tuple[tuple[Array | None, Array | None], ...]:
    """Return line and band of the left and the right side."""
    way = segment.end - segment.start
    length = float(np.linalg.norm(way))
    nothing: tuple[Array | None, Array | None] = (None, None)
    if not (np.isfinite(length) and length > 0.0):
        return nothing, nothing
    middle, direction = 0.5 * (segment.start + segment.end), way / length
    to_optical = mounting.inverse()
    point, along = to_optical.apply(middle), to_optical.rotate(direction)
    edges = visible_generatrices(point, along, segment.radius, camera.centre)
    if edges is None:
        return nothing, nothing
    shifted = [
        contour_lines(to_optical.apply(p), to_optical.rotate(d), segment.radius, camera)
        for p, d in _one_sigma(segment.covariance, middle, direction)
    ]
    sides = []
    for side, edge in enumerate(edges):
        line = _in_view(edge, along, camera)
        moved = [lines[side] for lines in shifted if lines is not None]
        band = None
        if line is not None and moved and len(moved) == len(shifted):
            band = _band(line, np.array(moved))
        sides.append((line, band))
    return tuple(sides)


def _one_sigma(covariance: Array, middle: Array, direction: Array) -> list[tuple[Array, Array]]:
    """Return the axis moved by each principal standard deviation; none where it is not known."""
    if not (np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all()):
        return []
    if abs(float(direction @ _VERTICAL)) > 1.0 - 1e-6:
        # A vertical pipe has no left.
        return []
    values, vectors = np.linalg.eigh(covariance)
    left, up = across(direction, _VERTICAL)
    level = float(np.hypot(direction[0], direction[1]))
    moved = []
    for aside, lift, heading, pitch in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        turned = direction + heading * level * left + pitch * up
        moved.append((middle + aside * left + lift * up, turned / np.linalg.norm(turned)))
    return moved


def _in_view(edge: Array, along: Array, camera: Camera) -> Array | None:
    """Return both ends (2, 2), px, of a line in space where a camera has it in view."""
    view = clip_line_to_view(edge, along, camera, _NEAR)
    if view is None:
        return None
    low, high = max(view[0], -_FAR), min(view[1], _FAR)
    if not low < high:
        return None
    return camera.project(np.stack((edge + low * along, edge + high * along)))


def _band(line: Array, moved: Array) -> Array:
    """Return a polygon around a line (2, 2), px, from the lines (K, 3) of its standard errors."""
    shares = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    points = line[0] + shares * (line[1] - line[0])
    # A line has no sign: the distances of one line to all points must have the same sense.
    way = (line[1] - line[0]) / max(float(np.linalg.norm(line[1] - line[0])), 1e-9)
    normal = np.array([-way[1], way[0]])
    moved = moved * np.where(moved[:, :2] @ normal < 0.0, -1.0, 1.0)[:, None]
    distances = points @ moved[:, :2].T + moved[:, 2]
    half = _BAND * np.sqrt(np.square(distances).sum(axis=1))[:, None]
    return np.concatenate((points + half * normal, (points - half * normal)[::-1]))
