"""Matches between the two rectified images: coarse to fine, then to sub-pixel (4.2.4, technique 1).

Points are chosen without any prediction, so a pair gives the same matches whatever came before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.vectorization.coarse_disparity import (
    COARSE,
    chosen_points,
    coarse_disparities,
)
from pipeline_tracker.vectorization.patch_alignment import align_patch, patch_weights, smoothed
from pipeline_tracker.vectorization.segments import shrink

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
Points = NDArray[np.int64]

# Half size of the patches at half the size: 11 x 11 px, and how far from the coarse disparity, px.
_HALF_PATCH, _REACH = 5, 2
# Least correlation there, and of the patches once they are aligned at full size.
_LEAST_COARSE, _LEAST_ALIGNED = 0.35, 0.7
_MIN_SEGMENT = 40.0


class StereoLevels(NamedTuple):
    """A pair prepared for matching.

    Attributes:
        left, right: smoothed, full size, (H, W) float32.
        half_left, half_right: at half the size, (H // 2, W // 2) uint8.
        coarse: disparities at a quarter of the size, (h, w) float32, coarse px, NaN unknown.
    """

    left: Float32Array
    right: Float32Array
    half_left: Image
    half_right: Image
    coarse: Float32Array


def stereo_levels(left: Image, right: Image) -> StereoLevels:
    """Prepare a rectified pair, (H, W) uint8 each, for matching."""
    half_left, half_right = (np.ascontiguousarray(shrink(image, 2)) for image in (left, right))
    coarse = coarse_disparities(shrink(half_left, 2), shrink(half_right, 2))
    return StereoLevels(smoothed(left), smoothed(right), half_left, half_right, coarse)


@compiled
def correlation(left: Image, right: Image, xl: int, xr: int, y: int, half: int) -> float:
    """Zero-mean normalised cross-correlation of two square patches in one row, -1 to 1.

    A patch without any contrast gives -1. The caller keeps the patches inside the images.
    """
    n = (2 * half + 1) * (2 * half + 1)
    sl = 0
    sr = 0
    sll = 0
    srr = 0
    slr = 0
    for v in range(y - half, y + half + 1):
        for k in range(-half, half + 1):
            a = int(left[v, xl + k])
            b = int(right[v, xr + k])
            sl += a
            sr += b
            sll += a * a
            srr += b * b
            slr += a * b
    vl = float(n * sll - sl * sl)
    vr = float(n * srr - sr * sr)
    if vl <= 0.0 or vr <= 0.0:
        return -1.0
    return float(float(n * slr - sl * sr) / np.sqrt(vl * vr))


@compiled
def _half_disparity(
    left: Image, right: Image, x: int, y: int, first: int, last: int
) -> tuple[float, float]:
    """Return the best disparity in ``first..last``, to a part of a pixel, and its correlation."""
    half = _HALF_PATCH
    best = -2.0
    where = first
    for d in range(first, last + 1):
        if x - d - half < 0 or x - d + half >= right.shape[1]:
            continue
        value = correlation(left, right, x, x - d, y, half)
        if value > best:
            best = value
            where = d
    place = x - where
    if best < _LEAST_COARSE or place - half < 1 or place + half >= right.shape[1] - 1:
        return float(where), best
    before = correlation(left, right, x, place + 1, y, half)
    after = correlation(left, right, x, place - 1, y, half)
    curvature = 2.0 * best - before - after
    if curvature <= 0.0 or before > best or after > best:
        return float(where), best
    return where + 0.5 * (after - before) / curvature, best


@compiled
def _match(levels: StereoLevels, weights: Float32Array, points: Points) -> Float32Array:
    """Match points of the left image in the right one; see ``match_points``."""
    out = np.empty((points.shape[0], 4), np.float32)
    count = 0
    height, width = levels.left.shape
    rows, columns = levels.coarse.shape
    half_height, half_width = levels.half_left.shape
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        if x < 0 or y < 0 or x >= width or y >= height or rows == 0 or columns == 0:
            continue
        coarse = levels.coarse[min(y // COARSE, rows - 1), min(x // COARSE, columns - 1)]
        if not coarse >= 0.0:
            continue
        xh = x // 2
        yh = y // 2
        if (
            xh < _HALF_PATCH
            or yh < _HALF_PATCH
            or xh >= half_width - _HALF_PATCH
            or yh >= half_height - _HALF_PATCH
        ):
            continue
        middle = int(np.rint(2.0 * coarse))
        d, value = _half_disparity(
            levels.half_left, levels.half_right, xh, yh, middle - _REACH, middle + _REACH
        )
        if value < _LEAST_COARSE:
            continue
        disparity, value = align_patch(levels.left, levels.right, weights, x, y, 2.0 * d)
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
    points: list[tuple[int, int]] = []
    for x1, y1, x2, y2 in segments.astype(np.float64):
        length = float(np.hypot(x2 - x1, y2 - y1))
        # Along a row every place of a line looks alike: nothing to match.
        if length < _MIN_SEGMENT or abs(y2 - y1) < 0.3 * length:
            continue
        count = max(1, int(length // spacing))
        for k in range(count):
            t = (k + 0.5) / count
            points.append((round(x1 + t * (x2 - x1)), round(y1 + t * (y2 - y1))))
    return np.array(sorted(set(points)), np.int64).reshape(-1, 2)


def match_points(levels: StereoLevels, points: Points) -> Float32Array:
    """Match points of the left rectified image in the right one with sub-pixel accuracy.

    Args:
        levels: the prepared pair.
        points: (N, 2) int64, x y in the left image, px.

    Returns:
        (M, 4) float32, x_left y_left x_right y_right, px, of those that could be matched.
    """
    return _match(levels, patch_weights(), points)


def match_pair(left: Image, right: Image, segments: Float32Array, spacing: int) -> Float32Array:
    """Match a rectified pair on a fixed grid and along the longer segments.

    Args:
        left, right: (H, W) uint8.
        segments: of the left image, (N, 4) float32, px.
        spacing: of the grid where it is finest, px.

    Returns:
        (M, 4) float32, x_left y_left x_right y_right, px.
    """
    levels = stereo_levels(left, right)
    height, width = left.shape
    grid = chosen_points(levels.coarse, width, height, spacing)
    along = segment_points(segments, 2 * spacing)
    return match_points(levels, np.concatenate((grid, along)))
