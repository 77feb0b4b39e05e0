"""Disparity and slant of one patch, to a small part of a pixel (4.2.4, technique 1).

A patch on the pipe's flank is slanted towards the camera: matched as if it faced the camera it is
off by tenths of a pixel, so the slant is fitted with the disparity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled, compiled_sums

Image = NDArray[np.uint8]
Smooth = NDArray[np.uint16]
Float32Array = NDArray[np.float32]

# Of the patch, across and down: half its size and Gaussian weight (one sigma), px. The weights'
# mean square is the same both ways.
_HALF, _SIGMA = 9, 5.5
_TALL, _SIGMA_DOWN = 10, 4.81
# Of the rows each second is looked at: the image is smoothed, so that it tells of its neighbours.
_ROW_STEP = 2
# A column without weight is added: a row is made of whole groups of pixels computed at once.
_ROWS, _COLUMNS = 2 * _TALL // _ROW_STEP + 1, 2 * _HALF + 2
_PIXELS = _ROWS * _COLUMNS
# A step below the first is the last; a last one above the second has not settled.
_MOST_STEPS, _CONVERGED, _UNSETTLED = 7, 0.08, 0.1
# Farther from its start, or on a surface more slanted, the fit has slid to something else.
_FARTHEST, _STEEPEST = 1.5, 0.6
# Of the right image a window of such a width is looked at, px: as far as the fit may go, and from
# its left end to the patch's middle where the fit starts.
_WIDTH, _MIDDLE = 56, 26
# A weak pull to no slant: a patch with a single edge does not tell.
_PULL = 1e-3


class Patch(NamedTuple):
    """What a patch's pixels are, row by row, each (220,), 11 rows of 20.

    Attributes:
        weight: float32, Gaussian; 0 in the last column.
        across, down: float32, from the patch's middle, px.
        row: int32, where in a window of the right image its row begins.
    """

    weight: Float32Array
    across: Float32Array
    down: Float32Array
    row: NDArray[np.int32]


def make_patch() -> Patch:
    """Return the patch for ``align_patch``."""
    down, across = np.mgrid[-_TALL : _TALL + 1 : _ROW_STEP, -_HALF : _HALF + 2].astype(np.float32)
    weight = np.exp(-0.5 * (np.square(across / _SIGMA) + np.square(down / _SIGMA_DOWN)))
    weight[:, -1] = 0.0
    row = np.repeat(np.arange(_ROWS, dtype=np.int32) * _WIDTH, _COLUMNS)
    return Patch(weight.astype(np.float32).ravel(), across.ravel(), down.ravel(), row)


def patch_variance() -> float:
    """Return how far from its middle a patch looks: weighted mean square along one side, px²."""
    patch = make_patch()
    weight = patch.weight.astype(np.float64)
    return float(weight @ np.square(patch.across) / weight.sum())


@compiled
def smoothed(image: Image, out: Smooth) -> None:
    """Blur an image a little against its noise, for ``align_patch``: 1 2 1 along both sides.

    Args:
        image: (H, W) uint8.
        out: (H, W) uint16, filled with 16 times the blurred grey levels: nothing is rounded.
    """
    height, width = image.shape
    column = np.empty(width + 2, np.uint16)
    for y in range(height):
        above, row = image[max(y - 1, 0)], image[y]
        below, line = image[min(y + 1, height - 1)], out[y]
        for x in range(width):
            column[x + 1] = np.uint16(above[x]) + np.uint16(2) * np.uint16(row[x]) + below[x]
        column[0] = column[1]
        column[width + 1] = column[width]
        for x in range(width):
            line[x] = column[x] + np.uint16(2) * column[x + 1] + column[x + 2]


@compiled_sums
def _left_pixels(
    left: Smooth, x: int, y: int, base: np.float32, level: Float32Array, slope: Float32Array
) -> None:
    """Fill a patch's grey levels, less ``base``, and their derivatives along the row.

    Args:
        left: (H, W) uint16.
        x, y: the patch's first pixel.
        base: a grey level.
        level, slope: (220,), filled.
    """
    for j in range(level.shape[0] // _COLUMNS):
        near = left[y + j * _ROW_STEP, x - 1 : x + _COLUMNS + 1]
        for i in range(_COLUMNS):
            before, after = np.float32(near[i]), np.float32(near[i + 2])
            level[j * _COLUMNS + i] = np.float32(near[i + 1]) - base
            slope[j * _COLUMNS + i] = np.float32(0.5) * (after - before)


@compiled_sums
def _window(right: Smooth, x: int, y: int, base: np.float32, window: Float32Array) -> None:
    """Fill the grey levels, less ``base``, of a patch's rows, each from ``x`` on.

    Args:
        right: (H, W) uint16.
        x, y: the window's first pixel.
        base: a grey level.
        window: (11 * 56,), filled.
    """
    for j in range(window.shape[0] // _WIDTH):
        near = right[y + j * _ROW_STEP, x : x + _WIDTH]
        line = window[j * _WIDTH : (j + 1) * _WIDTH]
        for i in range(_WIDTH):
            line[i] = np.float32(near[i]) - base


@compiled_sums
def _right_sums(
    window: Float32Array,
    place: np.float32,
    slant_x: np.float32,
    slant_y: np.float32,
    patch: Patch,
    level: Float32Array,
    slope: Float32Array,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Sum up a patch as it is seen in a window of the right image.

    There are no arrays to write to, so that many pixels can be computed at once.

    Args:
        window: of the right image, (11 * 56,).
        place: of the patch's middle in it, px.
        slant_x, slant_y: of the patch.
        patch: its pixels.
        level, slope: of the patch in the left image, (220,).

    Returns:
        Weighted sums of the grey levels, their squares, and their products with the left ones; with
        the left slopes, these times the way across, and down.
    """
    two, four, five, three = np.float32(2), np.float32(4), np.float32(5), np.float32(3)
    spacing = np.float32(1) - slant_x
    sv = svv = slv = e0 = e1 = e2 = np.float32(0)
    for n in range(_PIXELS):
        exact = place + spacing * patch.across[n] - slant_y * patch.down[n]
        whole = np.int32(exact)
        f = exact - np.float32(whole)
        # Known not to be negative.
        k = np.uint32(patch.row[n] + whole)
        p0 = window[k - np.uint32(1)]
        p1 = window[k]
        p2 = window[k + np.uint32(1)]
        p3 = window[k + np.uint32(2)]
        # Cubic through four pixels: a straight line between two would pull to whole ones.
        c2 = two * p0 - five * p1 + four * p2 - p3
        c3 = three * (p1 - p2) + p3 - p0
        v = p1 + np.float32(0.5) * f * (p2 - p0 + f * (c2 + f * c3))
        wv = patch.weight[n] * v
        tv = slope[n] * wv
        sv += wv
        svv += wv * v
        slv += wv * level[n]
        e0 += tv
        e1 += tv * patch.across[n]
        e2 += tv * patch.down[n]
    return sv, svv, slv, e0, e1, e2


@compiled_sums
def align_patch(
    left: Smooth, right: Smooth, patch: Patch, x: int, y: int, start: float
) -> tuple[float, float]:
    """Fit disparity and slant of a patch; gain and offset of its grey levels are free.

    Gauss-Newton on ``left(x + i, y + j) = right(x + i - d - a i - b j, y + j)`` with the left
    patch's own derivatives, so that its normal equations are the same in each step.

    Args:
        left, right: (H, W) uint16, slightly blurred.
        patch: its pixels.
        x, y: the patch's middle in the left image, px.
        start: disparity to start from, px, good to about 1 px.

    Returns:
        Disparity at the middle, px, and the correlation of the aligned patches; -1 where the patch
        leaves an image, has nothing to align, or the fit does not settle.
    """
    height, width = left.shape
    if x < _HALF + 1 or y < _TALL or x >= width - _HALF - 2 or y >= height - _TALL:
        return start, -1.0
    # Where the right image ends the window ends with it.
    left_end = min(max(int(x - start) - _MIDDLE, 0), right.shape[1] - _WIDTH)
    if left_end < 0:
        return start, -1.0
    one, a_half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    # Of a length that the compiler does not know: else it writes out all rows, one by one.
    pixels = len(patch.weight)
    level, slope = np.empty(pixels, np.float32), np.empty(pixels, np.float32)
    window = np.empty(pixels // _COLUMNS * _WIDTH, np.float32)
    # Sums are of differences from the middle's grey level: float32 holds these better.
    base = np.float32(left[y, x])
    _left_pixels(left, x - _HALF, y - _TALL, base, level, slope)
    _window(right, left_end, y - _TALL, base, window)
    sw = sl = sll = s0 = s1 = s2 = b0 = b1 = b2 = zero
    h00 = h01 = h02 = h11 = h12 = h22 = zero
    for n in range(_PIXELS):
        w, across, down = patch.weight[n], patch.across[n], patch.down[n]
        wl, u0 = w * level[n], w * slope[n]
        u1, u2 = u0 * across, u0 * down
        sw += w
        sl += wl
        sll += wl * level[n]
        s0 += u0
        s1 += u1
        s2 += u2
        b0 += u0 * level[n]
        b1 += u1 * level[n]
        b2 += u2 * level[n]
        h00 += u0 * slope[n]
        h01 += u1 * slope[n]
        h02 += u2 * slope[n]
        h11 += u1 * slope[n] * across
        h12 += u1 * slope[n] * down
        h22 += u2 * slope[n] * down
    contrast = sll * sw - sl * sl
    if contrast <= zero:
        return start, -1.0
    mean = sl / sw
    b0 -= mean * s0
    b1 -= mean * s1
    b2 -= mean * s2
    h00 -= s0 * s0 / sw
    h01 -= s0 * s1 / sw
    h02 -= s0 * s2 / sw
    pull = np.float32(_PULL) * np.float32(_HALF * _HALF) * h00
    h11 += pull - s1 * s1 / sw
    h12 -= s1 * s2 / sw
    h22 += pull - s2 * s2 / sw
    c00 = h11 * h22 - h12 * h12
    c01 = h02 * h12 - h01 * h22
    c02 = h01 * h12 - h02 * h11
    c11 = h00 * h22 - h02 * h02
    c12 = h01 * h02 - h00 * h12
    c22 = h00 * h11 - h01 * h01
    determinant = h00 * c00 + h01 * c01 + h02 * c02
    if determinant <= np.float32(1e-5) * h00 * h11 * h22:
        return start, -1.0
    disparity, slant_x, slant_y = np.float32(start), zero, zero
    step, quality = one, -one
    for _ in range(_MOST_STEPS):
        place = np.float32(x - left_end) - disparity
        wide, tall = (one - slant_x) * np.float32(_HALF + 1), abs(slant_y) * np.float32(_TALL)
        # Written so that NaN is not inside.
        inside = place - wide - tall >= one and place + wide + tall < np.float32(_WIDTH - 3)
        if not inside:
            return start, -1.0
        sv, svv, slv, e0, e1, e2 = _right_sums(window, place, slant_x, slant_y, patch, level, slope)
        spread = svv * sw - sv * sv
        if spread <= zero:
            return start, -1.0
        common = slv * sw - sl * sv
        quality = common / np.sqrt(contrast * spread)
        gain = common / spread
        middle = sv / sw
        r0 = b0 - gain * (e0 - middle * s0)
        r1 = b1 - gain * (e1 - middle * s1)
        r2 = b2 - gain * (e2 - middle * s2)
        step = (c00 * r0 + c01 * r1 + c02 * r2) / determinant
        turn_x = (c01 * r0 + c11 * r1 + c12 * r2) / determinant
        turn_y = (c02 * r0 + c12 * r1 + c22 * r2) / determinant
        disparity -= step
        slant_x -= turn_x
        slant_y -= turn_y
        if (
            abs(disparity - np.float32(start)) > np.float32(_FARTHEST)
            or abs(slant_x) > np.float32(_STEEPEST)
            or abs(slant_y) > np.float32(_STEEPEST)
        ):
            return start, -1.0
        # The middle may be right at once, and the slant not yet.
        turned = a_half * np.float32(_HALF) * (abs(turn_x) + abs(turn_y))
        if abs(step) < np.float32(_CONVERGED) and turned < np.float32(_UNSETTLED):
            break
    # Written so that NaN has not settled.
    if not abs(step) < np.float32(_UNSETTLED):
        return start, -1.0
    return float(disparity), float(quality)
