"""Raster to one-pixel edges with sub-pixel places (4.1.1): gradient, suppression, thresholds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Float32Array = NDArray[np.float32]
Int16Array = NDArray[np.int16]

# What a pixel may be: no edge, one that goes on from another, one that may begin a chain.
NO_EDGE, WEAK, STRONG = 0, 1, 2


@compiled
def gradient_magnitude(dx: Int16Array, dy: Int16Array, magnitude: Float32Array) -> None:
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
    dx: Int16Array,
    dy: Int16Array,
    magnitude: Float32Array,
    low: float,
    high: float,
    ridge: NDArray[np.uint8],
) -> None:
    """Keep the ridge of the gradient, one pixel wide.

    Args:
        dx, dy: derivatives, (H, W) int16.
        magnitude: (H, W) float32.
        low: magnitudes below are no edge.
        high: magnitudes from here on are strong.
        ridge: (H, W) uint8, filled with NO_EDGE, WEAK, STRONG. The border of 2 px is empty.
    """
    height, width = magnitude.shape
    ridge[:2] = 0
    ridge[max(height - 2, 0) :] = 0
    ridge[:, :2] = 0
    ridge[:, max(width - 2, 0) :] = 0
    zero, floor, strong = np.float32(0), np.float32(low), np.float32(high)
    for y in range(2, height - 2):
        above, row, below = magnitude[y - 1], magnitude[y], magnitude[y + 1]
        # Without a branch or a division, and all neighbours read whether they are needed or not:
        # so several pixels are done at once.
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
            less, more = min(ax, ay), max(ax, ay)
            # Magnitudes one step along the gradient, between two pixels: less / more of the way
            # from the one straight on to the diagonal one. All is multiplied by ``more``.
            straight = south if steep else east
            opposite = north if steep else west
            diagonal = south_east if falling else (south_west if steep else north_east)
            antidiagonal = north_west if falling else (north_east if steep else south_west)
            over_one = more * (here - straight) - less * (diagonal - straight)
            over_other = more * (here - opposite) - less * (antidiagonal - opposite)
            # ">" on one side and ">=" on the other keep one pixel of a plateau.
            kept = (here >= floor) & (over_one > zero) & (over_other >= zero)
            ridge[y, x] = np.uint8(kept) + np.uint8(kept & (here >= strong))


@compiled
def ridge_offset(
    dx: Int16Array, dy: Int16Array, magnitude: Float32Array, place: int, width: int
) -> float:
    """Return how far a pixel's centre is from the ridge along the gradient, px, -0.5 to 0.5.

    By a parabola through three magnitudes: the pixel's, and those one step ahead and behind.

    Args:
        dx, dy, magnitude: flat.
        place: flat index of a pixel of the ridge.
        width: of a row.
    """
    gx = float(dx[place])
    gy = float(dy[place])
    along = (1 if gx > 0.0 else -1, width if gy > 0.0 else -width)
    ax, ay = abs(gx), abs(gy)
    straight = along[1] if ay > ax else along[0]
    diagonal = along[0] + along[1]
    w = min(ax, ay) / max(ax, ay, 1e-6)
    here = float(magnitude[place])
    ahead = float(magnitude[place + straight])
    ahead += w * (float(magnitude[place + diagonal]) - ahead)
    behind = float(magnitude[place - straight])
    behind += w * (float(magnitude[place - diagonal]) - behind)
    curvature = max(here + here - ahead - behind, 1e-6)
    return float(0.5 * np.sqrt(1.0 + w * w) * (ahead - behind) / curvature)
