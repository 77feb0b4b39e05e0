"""Raster to one-pixel edges with sub-pixel places (4.1.1): gradient, suppression, thresholds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Float32Array = NDArray[np.float32]


@compiled
def gradient_magnitude(dx: NDArray[np.int16], dy: NDArray[np.int16]) -> Float32Array:
    """Return |gradient| of an image, (H, W) float32, from its derivatives (H, W) int16."""
    height, width = dx.shape
    magnitude = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            gx = np.float32(dx[y, x])
            gy = np.float32(dy[y, x])
            magnitude[y, x] = np.sqrt(gx * gx + gy * gy)
    return magnitude


@compiled
def magnitude_quantile(magnitude: Float32Array, share: float, step: int) -> float:
    """Return the value below which ``share`` of the magnitudes lie, by every ``step``-th pixel.

    Rounded down to a whole number, so that it is never above all magnitudes.
    """
    bins = np.zeros(2048, np.int64)
    count = 0
    height, width = magnitude.shape
    for y in range(0, height, step):
        for x in range(0, width, step):
            value = int(magnitude[y, x])
            bins[min(value, 2047)] += 1
            count += 1
    wanted = share * count
    total = 0
    for value in range(2048):
        total += bins[value]
        if total >= wanted:
            return float(value)
    return 2047.0


@compiled
def suppress_non_maxima(
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    magnitude: Float32Array,
    low: float,
    offset: Float32Array,
) -> NDArray[np.uint8]:
    """Keep the ridge of the gradient, one pixel wide.

    Args:
        dx, dy: derivatives, (H, W) int16.
        magnitude: (H, W) float32.
        low: magnitudes below are no edge.
        offset: (H, W) float32, filled where there is an edge: px from the pixel's centre to the
            ridge along the gradient, -0.5 to 0.5, by a parabola through three magnitudes.

    Returns:
        (H, W) uint8, 1 on the ridge, else 0. The border of 2 px is empty.
    """
    height, width = magnitude.shape
    ridge = np.zeros((height, width), np.uint8)
    for y in range(2, height - 2):
        for x in range(2, width - 2):
            here = magnitude[y, x]
            if here < low:
                continue
            gx = np.float32(dx[y, x])
            gy = np.float32(dy[y, x])
            ax = abs(gx)
            ay = abs(gy)
            # Magnitudes one step along the gradient, interpolated between two pixels.
            if ax >= ay:
                sx = 1 if gx > 0 else -1
                t = gy / gx * sx
                sy = 1 if t > 0 else -1
                w = abs(t)
                ahead = (1 - w) * magnitude[y, x + sx] + w * magnitude[y + sy, x + sx]
                behind = (1 - w) * magnitude[y, x - sx] + w * magnitude[y - sy, x - sx]
            else:
                sy = 1 if gy > 0 else -1
                t = gx / gy * sy
                sx = 1 if t > 0 else -1
                w = abs(t)
                ahead = (1 - w) * magnitude[y + sy, x] + w * magnitude[y + sy, x + sx]
                behind = (1 - w) * magnitude[y - sy, x] + w * magnitude[y - sy, x - sx]
            # ">" on one side and ">=" on the other keep one pixel of a plateau.
            if here > ahead and here >= behind:
                curvature = 2 * here - ahead - behind
                step = np.sqrt(np.float32(1.0) + w * w)
                if curvature > 0:
                    offset[y, x] = step * (ahead - behind) / (2 * curvature)
                else:
                    offset[y, x] = 0.0
                ridge[y, x] = 1
    return ridge
