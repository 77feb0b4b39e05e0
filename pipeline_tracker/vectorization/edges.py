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
        # Without a branch or a division, all neighbours read whether they are needed or not, each
        # from a row of its own, whose places count from 0: so several pixels are done at once.
        to_west, inside, to_east = slice(1, width - 3), slice(2, width - 2), slice(3, width - 1)
        nw_row, n_row, ne_row = above[to_west], above[inside], above[to_east]
        w_row, here_row, e_row = row[to_west], row[inside], row[to_east]
        sw_row, s_row, se_row = below[to_west], below[inside], below[to_east]
        gx_row, gy_row, out = dx[y, inside], dy[y, inside], ridge[y, inside]
        for x in range(width - 4):
            here = here_row[x]
            gx = np.float32(gx_row[x])
            gy = np.float32(gy_row[x])
            west, east, north, south = w_row[x], e_row[x], n_row[x], s_row[x]
            north_west, north_east = nw_row[x], ne_row[x]
            south_west, south_east = sw_row[x], se_row[x]
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
            out[x] = np.uint8(kept) + np.uint8(kept & (here >= strong))


@compiled
def ridge_offset(
    dx: Int16Array, dy: Int16Array, magnitude: Float32Array, place: int, width: int
) -> np.float32:
    """Return how far a pixel's centre is from the ridge along the gradient, px, -0.5 to 0.5.

    By a parabola through three magnitudes: the pixel's, and those one step ahead and behind.

    Args:
        dx, dy, magnitude: flat.
        place: flat index of a pixel of the ridge.
        width: of a row.
    """
    half, one, least = np.float32(0.5), np.float32(1), np.float32(1e-6)
    gx, gy = dx[np.uint64(place)], dy[np.uint64(place)]
    ax, ay = np.float32(abs(gx)), np.float32(abs(gy))
    to_side, down = (1 if gx > 0 else -1), (width if gy > 0 else -width)
    straight, diagonal = (down if ay > ax else to_side), to_side + down
    w = min(ax, ay) / max(ax, ay, least)
    # Known not to be negative: an edge is never in the border.
    here = magnitude[np.uint64(place)]
    ahead = magnitude[np.uint64(place + straight)]
    ahead += w * (magnitude[np.uint64(place + diagonal)] - ahead)
    behind = magnitude[np.uint64(place - straight)]
    behind += w * (magnitude[np.uint64(place - diagonal)] - behind)
    curvature = max(here + here - ahead - behind, least)
    return np.float32(half * np.sqrt(one + w * w) * (ahead - behind) / curvature)
