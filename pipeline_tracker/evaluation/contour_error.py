"""How far the published contour lines are from the true contours, px."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.evaluation.contours import (
    DETECTABLE_SHARE,
    OUTSIDE,
    VISIBLE,
    TrueContours,
    visible_share,
)
from pipeline_tracker.types import Contours, PipeSegment

Array = NDArray[np.float64]

# Bits of visible_contours in their order: image (0 left, 1 right) and side (0 left, 1 right).
LINES = {
    "left_image_left": (Contours.LEFT_IMAGE_LEFT, 0, 0),
    "left_image_right": (Contours.LEFT_IMAGE_RIGHT, 0, 1),
    "right_image_left": (Contours.RIGHT_IMAGE_LEFT, 1, 0),
    "right_image_right": (Contours.RIGHT_IMAGE_RIGHT, 1, 1),
}
# A line is looked at in points so far apart, px.
_SPACING = 4.0


@dataclass(frozen=True)
class LineResult:
    """One contour in one image, measured.

    A line is measured where it lies beside a part of the true contour that is inside the image.

    Attributes:
        seen: whether the bit is set: a line was published.
        error, worst: mean and greatest distance of the line's points from the true contour, px;
            None without a line, or with none of it beside the contour inside the image.
        ends: mean distance of the first and the last point measured, px; None likewise.
        visible_error: mean distance beside the visible part, px; None likewise, and where it is
            not known what is hidden.
        not_visible: a line was published and the true contour is hidden or outside all along.
        wrong_side: a line was published and is nearer to the pipe's other contour.
        missed: no line was published of a contour of whose length in view at least a quarter is
            visible; None where it is not known what is hidden.
    """

    seen: bool
    error: float | None = None
    worst: float | None = None
    ends: float | None = None
    visible_error: float | None = None
    not_visible: bool = False
    wrong_side: bool = False
    missed: bool | None = None


def measure_contours(
    segment: PipeSegment, truths: tuple[TrueContours | None, ...], *, reverse: bool
) -> dict[str, LineResult]:
    """Measure the contour lines of a segment.

    Args:
        segment: with a row of ``contours`` for each bit set.
        truths: the true contours of the left and the right image; None where not known.
        reverse: whether the segment leads against the direction in which the true axis is listed:
            its left is then the right of the true contours.

    Returns:
        By name of the line; without those of an image whose truth is not known.
    """
    rows = iter(segment.contours.astype(np.float64))
    results = {}
    for name, (bit, image, side) in LINES.items():
        line = next(rows) if segment.visible_contours & bit else None
        truth = truths[image]
        if truth is not None:
            results[name] = _measure(line, truth, 1 - side if reverse else side)
    return results


def _measure(line: Array | None, truth: TrueContours, side: int) -> LineResult:
    known = truth.hidden_known
    if line is None:
        share = visible_share(truth.pixels[side], truth.flags[side])
        missed = share is not None and share >= DETECTABLE_SHARE
        return LineResult(seen=False, missed=missed if known else None)
    points = _points(line)
    distances, flags = beside(points, truth.pixels[side], truth.flags[side])
    other, other_flags = beside(points, truth.pixels[1 - side], truth.flags[1 - side])
    inside, visible = flags != OUTSIDE, flags == VISIBLE
    other_inside = other_flags != OUTSIDE
    error = _mean(distances[inside])
    other_error = _mean(other[other_inside])
    return LineResult(
        seen=True,
        error=error,
        worst=float(distances[inside].max()) if inside.any() else None,
        ends=_mean(distances[inside][[0, -1]]) if inside.any() else None,
        visible_error=_mean(distances[visible]) if known else None,
        not_visible=not (truth.flags[side] == VISIBLE).any(),
        wrong_side=other_error is not None and (error is None or other_error < error),
        missed=False if known else None,
    )


def beside(
    points: Array, contour: Array, flags: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64]]:
    """Find how far points are from a contour, and what of it they lie beside.

    Args:
        points: (P, 2), px.
        contour: polyline in order, (S, 2), px; NaN where it is interrupted.
        flags: of its vertices, (S,).

    Returns:
        Distances (P,) px, and the flag (P,) of the vertex nearest along the contour; OUTSIDE for
        points beyond an end of the polyline.
    """
    start, end = contour[:-1], contour[1:]
    whole = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    whole &= np.any(start != end, axis=1)
    index = np.flatnonzero(whole)
    if not len(index):
        return np.full(len(points), np.inf), np.full(len(points), OUTSIDE)
    start, way = start[index], end[index] - start[index]
    along = np.einsum("psk,sk->ps", points[:, None] - start, way) / np.sum(way * way, axis=1)
    feet = start + np.clip(along, 0.0, 1.0)[..., None] * way
    distances = np.linalg.norm(points[:, None] - feet, axis=2)
    best = np.argmin(distances, axis=1)
    row = np.arange(len(points))
    share, piece = along[row, best], index[best]
    # Where a polyline ends there is nothing to be beside.
    first = ~np.isin(piece - 1, index)
    last = ~np.isin(piece + 1, index)
    beyond = (first & (share < 0.0)) | (last & (share > 1.0))
    nearest = flags[np.where(share > 0.5, piece + 1, piece)]
    return distances[row, best], np.where(beyond, OUTSIDE, nearest)


def _points(line: Array) -> Array:
    count = max(2, int(np.ceil(np.hypot(*(line[2:] - line[:2])) / _SPACING)) + 1)
    share = np.linspace(0.0, 1.0, count)[:, None]
    points: Array = line[:2] + share * (line[2:] - line[:2])
    return points


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None
