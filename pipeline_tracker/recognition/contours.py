"""Which contours? Hypotheses for the pipe from pairs of image lines (4.2.1, 4.2.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.recognition.groups import form_groups
from pipeline_tracker.recognition.hough import HoughLine, hough_lines
from pipeline_tracker.recognition.techniques import technique2
from pipeline_tracker.types import Float32Array, Image

Array = NDArray[np.float64]

# Thresholds at 1200 px width.
_GROUP_DISTANCE, _GROUP_ANGLE, _LONG = 8.0, 0.07, 30.0
_HEAVIEST_GROUPS = 24
_LINES = 12
REFERENCE_WIDTH = 1200.0
# A pipe nearer than this many radii fills the picture; one further than this many diameters is a
# line to the method.
_NEAREST_RADII, _FURTHEST_DIAMETERS = 1.2, 40.0
# A strip is called a shadow where it is darker than this share of both its neighbours.
_SHADOW_SHARE = 0.75
# ... and its brightness differs by less than this share of it; so many pixels of the thumbnail of
# it and of each neighbour tell.
_SHADOW_STRUCTURE, _SHADOW_PIXELS = 0.08, 12
# A line with a slope below this runs along the rows.
_LEVEL = 1e-9


def contour_candidates(segments: Float32Array, camera: Camera) -> list[HoughLine]:
    """Find the lines of an image that may be contours (4.2.2, 4.2.3).

    The modified Hough transform runs on the full set of segments and on the heaviest groups; lines
    found by both are kept once.

    Args:
        segments: (N, 4) float32, px.
        camera: the camera they were seen by.
    """
    scale = camera.width / REFERENCE_WIDTH
    size = (camera.width, camera.height)
    distance = max(3.0, 6.0 * scale)
    centre = ((camera.width - 1) / 2.0, (camera.height - 1) / 2.0)
    groups = form_groups(
        segments, centre, max(3.0, _GROUP_DISTANCE * scale), _GROUP_ANGLE, _LONG * scale
    )
    lines = hough_lines(segments, size, most=_LINES, distance=distance)
    if groups:
        members = np.concatenate([group.members for group in groups[:_HEAVIEST_GROUPS]])
        lines += hough_lines(segments[members], size, most=_LINES, distance=distance)
    kept: list[HoughLine] = []
    for line in sorted(lines, key=lambda entry: -entry.weight):
        if not any(_same_line(line.line, other.line, camera, distance) for other in kept):
            kept.append(line)
    return kept[:_LINES]


def _same_line(a: Array, b: Array, camera: Camera, distance: float) -> bool:
    if abs(float(a[:2] @ b[:2])) < np.cos(0.05):
        return False
    sign = 1.0 if float(a[:2] @ b[:2]) > 0 else -1.0
    centre = np.array([camera.cx, camera.cy])
    gap = float(a[:2] @ centre) + a[2] - sign * (float(b[:2] @ centre) + b[2])
    return bool(abs(gap) < distance)


def pair_hypotheses(
    lines: list[HoughLine], camera: Camera, radius: float, thumbnail: Image
) -> list[tuple[Axis, float]]:
    """Pair lines to contours and compute the axis of each pair by technique 2.

    A pair is dropped where the distance that it implies is not one at which a pipe can be seen, or
    where the strip between its lines is a shadow.

    Args:
        lines: contour candidates of one image.
        camera: its camera.
        radius: m.
        thumbnail: the image at an eighth of its size, uint8.

    Returns:
        Axes (left optical frame) with the weight of their two lines, px.
    """
    found = []
    for i, first in enumerate(lines):
        for second in lines[i + 1 :]:
            # Contours converge, but not by more than a wide-angle view of a near pipe allows.
            if abs(float(first.line[:2] @ second.line[:2])) < 0.75:
                continue
            axis = technique2(first.line, second.line, camera, radius)
            if axis is None or axis.point[2] <= radius:
                continue
            distance = float(np.linalg.norm(axis.point - camera.centre))
            if not _NEAREST_RADII * radius < distance < _FURTHEST_DIAMETERS * 2.0 * radius:
                continue
            if is_shadow(first.line, second.line, thumbnail, 8.0):
                continue
            found.append((axis, first.weight + second.weight))
    return found


def is_shadow(first: Array, second: Array, thumbnail: Image, shrunk: float) -> bool:
    """Tell whether the strip between two lines is a shadow: darker than what is on both sides.

    A dark pipe on bright sand looks the same in one picture; the caller has other evidence for it,
    so only a strip much darker than both neighbours *and* without structure is called a shadow.

    Args:
        first, second: homogeneous lines, px of the full image.
        thumbnail: uint8, the image shrunk.
        shrunk: by which factor.
    """
    if thumbnail.size == 0:
        return False
    return _darker_between(first, second, np.ascontiguousarray(thumbnail), shrunk)


@compiled
def _columns_between(
    first: float, second: float, at_first: float, at_second: float, columns: int
) -> tuple[int, int]:
    """Return the range of columns in which two linear functions of the column may differ in sign.

    Args:
        first, second: their slopes.
        at_first, at_second: their values at column 0.
        columns: how many there are.
    """
    if abs(first) < _LEVEL or abs(second) < _LEVEL:
        return 0, columns
    a, b = -at_first / first, -at_second / second
    low, high = max(min(a, b), 0.0), min(max(a, b) + 1.0, 1.0 * columns)
    return (int(low), int(high)) if low < high else (0, 0)


@compiled
def _darker_between(first: Array, second: Array, thumbnail: Image, shrunk: float) -> bool:
    """See ``is_shadow``; the thumbnail is not empty."""
    widths = np.empty(thumbnail.size)
    inside, mean, spread = _strip(first, second, thumbnail, shrunk, widths)
    if inside < _SHADOW_PIXELS or not spread < _SHADOW_STRUCTURE * max(mean, 1.0):
        return False
    beside = _beside(first, second, thumbnail, shrunk, np.median(widths[:inside]))
    return mean < _SHADOW_SHARE * beside


@compiled
def _values(
    first: Array, second: Array, row: int, shrunk: float
) -> tuple[float, float, float, float]:
    """Return both lines' values at the first pixel of a row of the thumbnail, and their slopes."""
    sign = -1.0 if first[0] * second[0] + first[1] * second[1] < 0.0 else 1.0
    x, y = 0.5 * shrunk - 0.5, (row + 0.5) * shrunk - 0.5
    a = first[0] * x + first[1] * y + first[2]
    b = sign * (second[0] * x + second[1] * y + second[2])
    return a, b, shrunk * first[0], sign * shrunk * second[0]


@compiled
def _strip(
    first: Array, second: Array, thumbnail: Image, shrunk: float, widths: Array
) -> tuple[int, float, float]:
    """Fill the strip's width at each pixel between two lines; how many, their mean and spread."""
    count = 0
    total = 0.0
    squares = 0.0
    for row in range(thumbnail.shape[0]):
        a, b, da, db = _values(first, second, row, shrunk)
        begin, end = _columns_between(da, db, a, b, thumbnail.shape[1])
        for column in range(begin, end):
            at_first, at_second = a + column * da, b + column * db
            if min(at_first, at_second) < 0.0 < max(at_first, at_second):
                value = float(thumbnail[row, column])
                widths[count] = abs(at_first - at_second)
                count += 1
                total += value
                squares += value * value
    if count == 0:
        return 0, 0.0, 0.0
    mean = total / count
    return count, mean, np.sqrt(max(0.0, squares / count - mean * mean))


@compiled
def _beside(first: Array, second: Array, thumbnail: Image, shrunk: float, width: float) -> float:
    """Return the darker mean of what is beside a strip, as far as half its width; 0 of too few."""
    before = after = 0
    dark_before = dark_after = 0.0
    for row in range(thumbnail.shape[0]):
        a, b, da, db = _values(first, second, row, shrunk)
        for column in range(thumbnail.shape[1]):
            at_first, at_second = a + column * da, b + column * db
            if -0.5 * width < max(at_first, at_second) <= 0.0:
                before += 1
                dark_before += thumbnail[row, column]
            if 0.0 <= min(at_first, at_second) < 0.5 * width:
                after += 1
                dark_after += thumbnail[row, column]
    if before < _SHADOW_PIXELS or after < _SHADOW_PIXELS:
        return 0.0
    return min(dark_before / before, dark_after / after)
