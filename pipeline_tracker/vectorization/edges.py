"""Raster to one-pixel edges with sub-pixel places (4.1.1): gradient, suppression, thresholds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Float32Array = NDArray[np.float32]


@compiled
def gradient_magnitude(
    dx: NDArray[np.int16], dy: NDArray[np.int16], magnitude: Float32Array
) -> None:
    """Fill |gradient| of an image, (H, W) float32, from its derivatives (H, W) int16."""
    height, width = dx.shape
    for y in range(height):
        for x in range(width):
            gx = np.float32(dx[y, x])
            gy = np.float32(dy[y, x])
            magnitude[y, x] = np.sqrt(gx * gx + gy * gy)


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
    ridge: NDArray[np.uint8],
) -> None:
    """Keep the ridge of the gradient, one pixel wide.

    Args:
        dx, dy: derivatives, (H, W) int16.
        magnitude: (H, W) float32.
        low: magnitudes below are no edge.
        offset: (H, W) float32, filled; where there is an edge: px from the pixel's centre to the
            ridge along the gradient, -0.5 to 0.5, by a parabola through three magnitudes.
        ridge: (H, W) uint8, filled: 1 on the ridge, else 0. The border of 2 px is empty.
    """
    height, width = magnitude.shape
    ridge[:2] = 0
    ridge[max(height - 2, 0) :] = 0
    ridge[:, :2] = 0
    ridge[:, max(width - 2, 0) :] = 0
    zero, one, tiny = np.float32(0), np.float32(1), np.float32(1e-6)
    floor = np.float32(low)
    for y in range(2, height - 2):
        above, row, below = magnitude[y - 1], magnitude[y], magnitude[y + 1]
        # Without a branch, so that several pixels are done at once.
        for x in range(2, width - 2):
            here = row[x]
            gx = np.float32(dx[y, x])
            gy = np.float32(dy[y, x])
            west, east, north, south = row[x - 1], row[x + 1], above[x], below[x]
            north_west, north_east = above[x - 1], above[x + 1]
            south_west, south_east = below[x - 1], below[x + 1]
            ax, ay = abs(gx), abs(gy)
            steep = ay > ax
            falling = gx * gy > zero
            # Magnitudes one step along the gradient, interpolated between two pixels.
            w = min(ax, ay) / max(ax, ay, tiny)
            straight = south if steep else east
            opposite = north if steep else west
            diagonal = south_east if falling else (south_west if steep else north_east)
            antidiagonal = north_west if falling else (north_east if steep else south_west)
            plus = straight + w * (diagonal - straight)
            minus = opposite + w * (antidiagonal - opposite)
            forward = (gy if steep else gx) > zero
            ahead = plus if forward else minus
            behind = minus if forward else plus
            curvature = here + here - ahead - behind
            step = np.sqrt(one + w * w)
            part = step * (ahead - behind) / (max(curvature, tiny) * np.float32(2))
            # ">" on one side and ">=" on the other keep one pixel of a plateau.
            kept = (here >= floor) & (here > ahead) & (here >= behind)
            ridge[y, x] = kept
            offset[y, x] = part
