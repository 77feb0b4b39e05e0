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
# A column without weight is added, so that a row is made of whole groups of pixels; those of a
# group are sampled together.
_ROWS, _COLUMNS, _GROUP = 2 * _TALL // _ROW_STEP + 1, 2 * _HALF + 2, 4
_PIXELS = _ROWS * _COLUMNS
# A step below the first is the last; a last one above the second has not settled.
_MOST_STEPS, _CONVERGED, _UNSETTLED = 7, 0.08, 0.1
# Farther from its start, or on a surface more slanted, the fit has slid to something else.
_FARTHEST, _STEEPEST = 1.5, 0.6
# A weak pull to no slant: a patch with a single edge does not tell.
_PULL = 1e-3


class Patch(NamedTuple):
    """What a patch's pixels are, row by row, each (11 x 20,) float32.

    Attributes:
        weight: Gaussian; 0 in the last column.
        across, down: from the patch's middle, px.
    """

    weight: Float32Array
    across: Float32Array
    down: Float32Array


def make_patch() -> Patch:
    """Return the patch for ``align_patch``."""
    down, across = np.mgrid[-_TALL : _TALL + 1 : _ROW_STEP, -_HALF : _HALF + 2].astype(np.float32)
    weight = np.exp(-0.5 * (np.square(across / _SIGMA) + np.square(down / _SIGMA_DOWN)))
    weight[:, -1] = 0.0
    return Patch(weight.astype(np.float32).ravel(), across.ravel(), down.ravel())


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
def _sample(
    right: Smooth,
    x: int,
    y: int,
    disparity: np.float32,
    slant_x: np.float32,
    slant_y: np.float32,
    base: np.float32,
    samples: Float32Array,
) -> bool:
    """Fill a patch's grey levels, less ``base``, from where it is seen in the right image.

    Returns:
        Whether all of it is inside.
    """
    two, four, five, three = np.float32(2), np.float32(4), np.float32(5), np.float32(3)
    a_half = np.float32(0.5)
    spacing = np.float32(1) - slant_x
    for j in range(_ROWS):
        down = np.float32(j * _ROW_STEP - _TALL)
        begin = np.float32(x - _HALF) - disparity - slant_y * down + slant_x * np.float32(_HALF)
        end = begin + spacing * np.float32(_COLUMNS - 1)
        # Written so that NaN is not inside.
        if not (begin >= np.float32(3) and end < np.float32(right.shape[1] - 5)):
            return False
        row = right[y + j * _ROW_STEP - _TALL]
        for g in range(0, _COLUMNS, _GROUP):
            first = begin + spacing * np.float32(g)
            # One whole pixel for all of a group, that of its middle: they are read together, and
            # the cubic's own interval is left by a part of a pixel at most.
            whole = int(first - np.float32(0.5 * (_GROUP - 1)) * slant_x)
            part = first - np.float32(whole)
            # A view, so that its indices are known not to be negative.
            near = row[whole - 1 : whole + _GROUP + 2]
            for i in range(_GROUP):
                f = part - np.float32(i) * slant_x
                p0 = np.float32(near[i])
                p1 = np.float32(near[i + 1])
                p2 = np.float32(near[i + 2])
                p3 = np.float32(near[i + 3])
                # Cubic through four pixels: a straight line between two would pull to whole ones.
                c2 = two * p0 - five * p1 + four * p2 - p3
                c3 = three * (p1 - p2) + p3 - p0
                value = p1 + a_half * f * (p2 - p0 + f * (c2 + f * c3))
                samples[j * _COLUMNS + g + i] = value - base
    return True


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
    one, a_half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    arrays = np.empty((6, _PIXELS), np.float32)
    level, slope, samples = arrays[0], arrays[1], arrays[2]
    # Slopes by weight; the same times the way from the middle, across and down.
    t0, t1, t2 = arrays[3], arrays[4], arrays[5]
    # Sums are of differences from the middle's grey level: float32 holds these better.
    base = np.float32(left[y, x])
    for j in range(_ROWS):
        near = left[y + j * _ROW_STEP - _TALL, x - _HALF - 1 : x - _HALF + _COLUMNS + 1]
        for i in range(_COLUMNS):
            level[j * _COLUMNS + i] = np.float32(near[i + 1]) - base
            slope[j * _COLUMNS + i] = a_half * (np.float32(near[i + 2]) - np.float32(near[i]))
    sw = sl = sll = s0 = s1 = s2 = b0 = b1 = b2 = zero
    h00 = h01 = h02 = h11 = h12 = h22 = zero
    for n in range(_PIXELS):
        w, across, down = patch.weight[n], patch.across[n], patch.down[n]
        sw += w
        sl += w * level[n]
        sll += w * level[n] * level[n]
        u0 = w * slope[n]
        u1 = u0 * across
        u2 = u0 * down
        t0[n], t1[n], t2[n] = u0, u1, u2
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
        if not _sample(right, x, y, disparity, slant_x, slant_y, base, samples):
            return start, -1.0
        sv = svv = slv = e0 = e1 = e2 = zero
        for n in range(_PIXELS):
            v = samples[n]
            wv = patch.weight[n] * v
            sv += wv
            svv += wv * v
            slv += wv * level[n]
            e0 += t0[n] * v
            e1 += t1[n] * v
            e2 += t2[n] * v
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
