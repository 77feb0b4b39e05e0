"""Matches between the two rectified images: patches by ZNCC, coarse to fine (4.2.4, technique 1).

Points are chosen without any prediction, so a pair gives the same matches whatever came before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.vectorization.segments import shrink

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

# Half sizes of the patches at 1/4, 1/2 and full size: 9 x 9, 11 x 11 and 13 x 13 px.
_HALF_QUARTER, _HALF_HALF, _HALF_FULL = 4, 5, 6
# Disparities are sought up to this share of the width: at 65 degrees of view down to about three
# baselines away.
_LARGEST_DISPARITY = 0.25
_LEAST_COARSE, _LEAST_FINE = 0.35, 0.6
_MIN_SEGMENT = 40.0


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
def _best_disparity(
    left: Image, right: Image, x: int, y: int, lowest: int, highest: int, half: int
) -> tuple[int, float]:
    """Return the disparity of the best correlation in ``lowest..highest`` and its value."""
    width = right.shape[1]
    best = -2.0
    where = lowest
    for d in range(lowest, highest + 1):
        xr = x - d
        if xr - half < 0 or xr + half >= width:
            continue
        value = correlation(left, right, x, xr, y, half)
        if value > best:
            best = value
            where = d
    return where, best


@compiled
def _match(
    left: tuple[Image, Image, Image],
    right: tuple[Image, Image, Image],
    points: NDArray[np.int64],
    largest: int,
) -> Float32Array:
    """Match points of the left image in the right one; see ``match_points``."""
    height, width = left[0].shape
    out = np.empty((points.shape[0], 4), np.float32)
    count = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        if x < _HALF_FULL or y < _HALF_FULL or x >= width - _HALF_FULL or y >= height - _HALF_FULL:
            continue
        xq = x // 4
        yq = y // 4
        hq, wq = left[2].shape
        if (
            xq < _HALF_QUARTER
            or yq < _HALF_QUARTER
            or xq >= wq - _HALF_QUARTER
            or yq >= hq - _HALF_QUARTER
        ):
            continue
        d, value = _best_disparity(left[2], right[2], xq, yq, 0, largest // 4, _HALF_QUARTER)
        if value < _LEAST_COARSE:
            continue
        xh = x // 2
        yh = y // 2
        hh, wh = left[1].shape
        if xh < _HALF_HALF or yh < _HALF_HALF or xh >= wh - _HALF_HALF or yh >= hh - _HALF_HALF:
            continue
        d, value = _best_disparity(left[1], right[1], xh, yh, 2 * d - 2, 2 * d + 2, _HALF_HALF)
        if value < _LEAST_COARSE:
            continue
        d, value = _best_disparity(left[0], right[0], x, y, 2 * d - 2, 2 * d + 2, _HALF_FULL)
        xr = x - d
        if value < _LEAST_FINE or xr - _HALF_FULL < 1 or xr + _HALF_FULL >= width - 1:
            continue
        # Sub-pixel by a parabola through the best correlation and its neighbours.
        before = correlation(left[0], right[0], x, xr - 1, y, _HALF_FULL)
        after = correlation(left[0], right[0], x, xr + 1, y, _HALF_FULL)
        curvature = 2.0 * value - before - after
        if before > value or after > value or curvature <= 0.0:
            continue
        out[count, 0] = x
        out[count, 1] = y
        out[count, 2] = xr + 0.5 * (after - before) / curvature
        out[count, 3] = y
        count += 1
    return out[:count].copy()


def pyramid(image: Image) -> tuple[Image, Image, Image]:
    """Return an image at full, half and quarter size, each contiguous uint8."""
    half = np.ascontiguousarray(shrink(image, 2))
    # One kind of array for all sizes, as images of messages are: one compilation.
    full = np.ascontiguousarray(image).view()
    full.flags.writeable = False
    return full, half, np.ascontiguousarray(shrink(half, 2))


def grid_points(width: int, height: int, spacing: int) -> NDArray[np.int64]:
    """Return the points of a fixed grid, (N, 2) int64, x y, centred in the image."""
    xs = np.arange((width % spacing) // 2 + spacing // 2, width, spacing)
    ys = np.arange((height % spacing) // 2 + spacing // 2, height, spacing)
    gx, gy = np.meshgrid(xs, ys)
    return np.stack((gx.ravel(), gy.ravel()), axis=1).astype(np.int64)


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


def match_points(left: Image, right: Image, points: NDArray[np.int64]) -> Float32Array:
    """Match points of the left rectified image in the right one with sub-pixel accuracy.

    Args:
        left, right: (H, W) uint8.
        points: (N, 2) int64, x y in the left image, px.

    Returns:
        (M, 4) float32, x_left y_left x_right y_right, px, of those that could be matched.
    """
    largest = int(left.shape[1] * _LARGEST_DISPARITY)
    return _match(pyramid(left), pyramid(right), points, largest)
