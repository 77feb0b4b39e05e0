"""Matches between the two rectified images: coarse to fine, then to sub-pixel (4.2.4, technique 1).

Points are chosen without any prediction, so a pair gives the same matches whatever came before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.jit import compiled
from pipeline_tracker.vectorization.coarse_disparity import (
    coarse_disparities,
    coarse_side,
    grid_sides,
    raised_points,
    sparse_points,
)
from pipeline_tracker.vectorization.correlation import HALF, correlations
from pipeline_tracker.vectorization.patch_alignment import (
    Patch,
    Smooth,
    align_patch,
    make_patch,
    smoothed,
)
from pipeline_tracker.vectorization.row_offset import row_offset
from pipeline_tracker.vectorization.segments import pyramid
from pipeline_tracker.workspace import Workspace

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
Points = NDArray[np.int64]

# How far from the coarse disparity is looked at half the size, px.
_REACH = 4
# Least correlation there, and of the patches once they are aligned at full size.
_LEAST_COARSE, _LEAST_ALIGNED = 0.35, 0.7
_MIN_SEGMENT = 40.0
# A smaller share of matches comes by chance: the rows of the pair do not agree, or one image shows
# nothing. In clear water 0.9 are found, in water full of snow 0.25, of chance 0.1.
_LEAST_MATCHED = 0.15
# More rows than any image has.
_TALLEST = 1 << 32
_PATCH = make_patch()
# So far from its middle a patch looks at either image, px.
_PATCH_REACH = 2 * (HALF + 1)


class StereoLevels(NamedTuple):
    """A pair prepared for matching.

    Attributes:
        left, right: smoothed, full size, (H, W) uint16.
        half_left, half_right: at half the size, (H // 2, W // 2) uint8.
        coarse: disparities of coarse pixels, (h, w) float32, coarse px, NaN unknown.
        side: of a coarse pixel, px.
    """

    left: Smooth
    right: Smooth
    half_left: Image
    half_right: Image
    coarse: Float32Array
    side: int


def stereo_levels(
    left: Sequence[Image], right: Sequence[Image], workspace: Workspace | None = None
) -> StereoLevels:
    """Prepare a rectified pair for matching.

    Args:
        left, right: pyramids down to coarse pixels: (H, W) uint8, (H // 2, W // 2) and so on.
        workspace: where to compute; None: in new arrays.
    """
    array = (workspace or Workspace()).array
    smooth = [array(f"smooth_{name}", left[0].shape, np.uint16) for name in ("left", "right")]
    for image, out in zip((left[0], right[0]), smooth, strict=True):
        smoothed(image, out)
    side = coarse_side(left[0].shape[1])
    coarse = side.bit_length() - 1
    disparities = coarse_disparities(left[coarse], right[coarse])
    return StereoLevels(smooth[0], smooth[1], left[1], right[1], disparities, side)


@compiled
def _half_disparity(left: Image, right: Image, x: int, y: int, middle: int) -> tuple[float, float]:
    """Return the best disparity near ``middle``, to a part of a pixel, and its correlation.

    Climbs from the middle to the nearest maximum, a few pixels at most.
    """
    where, best = middle, -1.0
    for move in range(_REACH + 1):
        place = x - where
        if place - 1 < HALF or place + 1 + HALF >= right.shape[1]:
            return float(where), -1.0
        above, best, below = correlations(left, right, x, y, place, y)
        if best >= below and best >= above:
            curvature = 2.0 * best - below - above
            return where + (0.5 * (above - below) / curvature if curvature > 0.0 else 0.0), best
        if move < _REACH:
            where += 1 if above > below else -1
    return float(where), best


@compiled
def _half_disparities(levels: StereoLevels, points: Points) -> NDArray[np.float64]:
    """Match points of the left image at half the size.

    Args:
        levels: the prepared pair.
        points: (N, 2) int64, x y in the left image, px.

    Returns:
        (N,) px of the full size, good to about 0.2 px; NaN where nothing is alike.
    """
    out = np.full(points.shape[0], np.nan)
    rows, columns = levels.coarse.shape
    height, width = levels.half_left.shape
    side = levels.side
    for i in range(points.shape[0]):
        x = points[i, 0] // 2
        y = points[i, 1] // 2
        inside = HALF <= x < width - HALF and HALF <= y < height - HALF
        if not inside or rows == 0 or columns == 0:
            continue
        coarse = levels.coarse[
            min(points[i, 1] // side, rows - 1), min(points[i, 0] // side, columns - 1)
        ]
        if not coarse >= 0.0:
            continue
        middle = int(np.rint(0.5 * side * coarse))
        d, value = _half_disparity(levels.half_left, levels.half_right, x, y, middle)
        if value >= _LEAST_COARSE:
            out[i] = 2.0 * d
    return out


@compiled
def _match(
    levels: StereoLevels, patch: Patch, points: Points, starts: NDArray[np.float64]
) -> Float32Array:
    """Match points of the left image in the right one with sub-pixel accuracy.

    Args:
        levels: the prepared pair.
        patch: what is compared.
        points: (N, 2) int64, x y in the left image, px.
        starts: (N,) disparities to start from, px, see ``_half_disparities``.

    Returns:
        (M, 4) float32, x_left y_left x_right y_right, px, of those that could be matched.
    """
    out = np.empty((points.shape[0], 4), np.float32)
    count = 0
    width = levels.left.shape[1]
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        if np.isnan(starts[i]):
            continue
        disparity, value = align_patch(levels.left, levels.right, patch, x, y, starts[i])
        place = x - disparity
        if value < _LEAST_ALIGNED or place < 0.0 or place > width - 1:
            continue
        out[count, 0] = x
        out[count, 1] = y
        out[count, 2] = place
        out[count, 3] = y
        count += 1
    return out[:count].copy()


def segment_points(segments: Float32Array, spacing: int) -> NDArray[np.int64]:
    """Return points along the longer segments, (N, 2) int64; none on those that run along rows.

    Args:
        segments: (N, 4) float32, px.
        spacing: px between the points.
    """
    ends = segments.astype(np.float64)
    way = ends[:, 2:] - ends[:, :2]
    length = np.hypot(way[:, 0], way[:, 1])
    # Along a row every place of a line looks alike: nothing to match.
    usable = (length >= _MIN_SEGMENT) & (np.abs(way[:, 1]) >= 0.3 * length)
    ends, way, length = ends[usable], way[usable], length[usable]
    counts = np.maximum(1, length // spacing).astype(np.int64)
    owner = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (number + 0.5) / counts[owner]
    places = np.rint(ends[owner, :2] + share[:, None] * way[owner]).astype(np.int64)
    # As one number each, which is far quicker to sort than two.
    xs, ys = np.divmod(np.unique(places[:, 0] * _TALLEST + places[:, 1]), _TALLEST)
    return np.stack((xs, ys), axis=1)


def match_pair(
    left: Sequence[Image],
    right: Sequence[Image],
    segments: Float32Array,
    spacing: int,
    workspace: Workspace | None = None,
    unseen: UnseenPair = SEEN_WHOLE,
    factor: int = 1,
) -> Float32Array:
    """Match a rectified pair on a fixed grid and along the longer segments.

    Where the rows of the pair do not agree, ``y_right`` is off ``y_left`` by as much.

    Args:
        left, right: pyramids, see ``stereo_levels``.
        segments: of the left image, (N, 4) float32, px.
        spacing: of the grid where it is finest, px.
        workspace: where to compute; None: in new arrays.
        unseen: what of the images the cameras have not seen; nothing is matched there.
        factor: of the images to the masks of ``unseen``.

    Returns:
        (M, 4) float32, x_left y_left x_right y_right, px; none where they would be chance.
    """
    levels = stereo_levels(left, right, workspace)
    height, width = left[0].shape
    if unseen.left is not None:
        levels.coarse[unseen.left.grown(levels.side * factor, 0)] = np.nan
    columns, rows = grid_sides(width, height, spacing)
    sparse = sparse_points(columns, rows)
    apart = row_offset(levels.half_left, levels.half_right, levels.coarse, levels.side, sparse)
    if round(apart):
        shifted = np.clip(np.arange(height) + round(apart), 0, height - 1)
        levels = stereo_levels(left, pyramid(np.ascontiguousarray(right[0][shifted])), workspace)
    known = _half_disparities(levels, sparse)
    further = np.concatenate(
        (raised_points(columns, rows, known), segment_points(segments, 2 * spacing))
    )
    points = np.concatenate((sparse, further))
    starts = np.concatenate((known, _half_disparities(levels, further)))
    if unseen.left is not None:
        seen = ~unseen.left.near(points, factor, _PATCH_REACH)
        points, starts = points[seen], starts[seen]
    found = _match(levels, _PATCH, points, starts)
    found[:, 3] += np.float32(apart)
    if len(found) < _LEAST_MATCHED * len(points):
        return found[:0]
    if unseen.right is not None:
        found = found[~unseen.right.near(found[:, 2:], factor, _PATCH_REACH)]
    return found
