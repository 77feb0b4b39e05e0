"""Disparity and slant of one patch, to a small part of a pixel (4.2.4, technique 1).

A patch on the pipe's flank is slanted towards the camera: matched as if it faced the camera it is
off by tenths of a pixel, so the slant is fitted with the disparity.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled_sums

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

# Of the patch: half its size, Gaussian weight (one sigma) and blur of the images, px.
_HALF, _SIGMA, _BLUR = 8, 4.8, 0.7
_KERNEL = cv2.getGaussianKernel(7, _BLUR)
# A step below the first is the last; a last one above the second has not settled.
_MOST_STEPS, _CONVERGED, _UNSETTLED = 7, 0.04, 0.1
# Farther from its start, or on a surface more slanted, the fit has slid to something else.
_FARTHEST, _STEEPEST = 1.5, 0.6
# A weak pull to no slant: a patch with a single edge does not tell.
_PULL = 1e-3


def patch_variance() -> float:
    """Return how far from its middle a patch looks: weighted mean square along one side, px²."""
    off = np.arange(-_HALF, _HALF + 1)
    weights = patch_weights()[_HALF].astype(np.float64)
    return float(weights @ np.square(off) / weights.sum())


def patch_weights() -> Float32Array:
    """Return the weights of a patch's pixels for ``align_patch``, (17, 17) float32."""
    off = np.arange(-_HALF, _HALF + 1, dtype=np.float32)
    along = np.exp(-0.5 * np.square(off / np.float32(_SIGMA)))
    return np.ascontiguousarray(np.outer(along, along), np.float32)


def smoothed(image: Image, out: Float32Array | None = None) -> Float32Array:
    """Return an image for ``align_patch``: float32, blurred a little against its noise.

    Args:
        image: (H, W) uint8.
        out: (H, W) float32 to fill; None: a new array.
    """
    blurred = cv2.sepFilter2D(image, cv2.CV_32F, _KERNEL, _KERNEL, dst=out)
    return np.asarray(blurred, np.float32)


@compiled_sums
def align_patch(
    left: Float32Array, right: Float32Array, weights: Float32Array, x: int, y: int, start: float
) -> tuple[float, float]:
    """Fit disparity and slant of a patch; gain and offset of its grey levels are free.

    Gauss-Newton on ``left(x + i, y + j) = right(x + i - d - a i - b j, y + j)`` with the left
    patch's own derivatives, so that its normal equations are the same in each step.

    Args:
        left, right: (H, W) float32, slightly blurred.
        weights: (2 h + 1, 2 h + 1) float32 of the patch's pixels.
        x, y: the patch's middle in the left image, px.
        start: disparity to start from, px, good to about 1 px.

    Returns:
        Disparity at the middle, px, and the correlation of the aligned patches; -1 where the patch
        leaves an image, has nothing to align, or the fit does not settle.
    """
    size = weights.shape[0]
    half = size // 2
    height, width = left.shape
    if x < half + 1 or y < half or x >= width - half - 1 or y >= height - half:
        return start, -1.0
    two, four, five, three = np.float32(2), np.float32(4), np.float32(5), np.float32(3)
    one, a_half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    slopes = np.empty((size, size), np.float32)
    samples = np.empty(size, np.float32)
    sw = sl = sll = s0 = s1 = s2 = zero
    h00 = h01 = h02 = h11 = h12 = h22 = zero
    for j in range(size):
        row = left[y + j - half]
        down = np.float32(j - half)
        for i in range(size):
            across = np.float32(i - half)
            level = row[x + i - half]
            slope = a_half * (row[x + i - half + 1] - row[x + i - half - 1])
            w = weights[j, i]
            t = w * slope
            slopes[j, i] = t
            sw += w
            sl += w * level
            sll += w * level * level
            s0 += t
            s1 += t * across
            s2 += t * down
            q = t * slope
            h00 += q
            h01 += q * across
            h02 += q * down
            h11 += q * across * across
            h12 += q * across * down
            h22 += q * down * down
    contrast = sll * sw - sl * sl
    if contrast <= zero:
        return start, -1.0
    mean = sl / sw
    h00 -= s0 * s0 / sw
    h01 -= s0 * s1 / sw
    h02 -= s0 * s2 / sw
    pull = np.float32(_PULL) * np.float32(half * half) * h00
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
        sv = svv = slv = e0 = e1 = e2 = b0 = b1 = b2 = zero
        increment = one - slant_x
        for j in range(size):
            down = np.float32(j - half)
            begin = np.float32(x - half) - (disparity + slant_y * down) + slant_x * np.float32(half)
            if begin < one or begin + increment * np.float32(2 * half) >= width - 2:
                return start, -1.0
            row = right[y + j - half]
            for i in range(size):
                place = begin + increment * np.float32(i)
                k = int(place)
                f = place - np.float32(k)
                p0 = row[k - 1]
                p1 = row[k]
                p2 = row[k + 1]
                p3 = row[k + 2]
                # Cubic through four pixels: a straight line between two would pull to whole ones.
                c2 = two * p0 - five * p1 + four * p2 - p3
                c3 = three * (p1 - p2) + p3 - p0
                samples[i] = p1 + a_half * f * (p2 - p0 + f * (c2 + f * c3))
            row = left[y + j - half]
            for i in range(size):
                across = np.float32(i - half)
                v = samples[i] - mean
                level = row[x + i - half] - mean
                wv = weights[j, i] * v
                sv += wv
                svv += wv * v
                slv += wv * level
                t = slopes[j, i]
                e = t * v
                e0 += e
                e1 += e * across
                e2 += e * down
                b = t * level
                b0 += b
                b1 += b * across
                b2 += b * down
        spread = svv * sw - sv * sv
        if spread <= zero:
            return start, -1.0
        quality = slv * sw / np.sqrt(contrast * spread)
        gain = slv * sw / spread
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
        turned = a_half * np.float32(half) * (abs(turn_x) + abs(turn_y))
        if abs(step) < np.float32(_CONVERGED) and turned < np.float32(_UNSETTLED):
            break
    # Written so that NaN has not settled.
    if not abs(step) < np.float32(_UNSETTLED):
        return start, -1.0
    return float(disparity), float(quality)
