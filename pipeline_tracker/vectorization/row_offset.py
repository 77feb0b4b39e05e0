"""How far the rows of a pair are apart: 0 where it is rectified as it should be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.vectorization.correlation import HALF, correlations

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
Points = NDArray[np.int64]
Array = NDArray[np.float64]

# Least correlation of a match.
_LEAST_ALIKE = 0.6
# Rows are sought so far up and down, half-size px.
_ROWS = 4
# Points that are looked at, and how many of them must be found.
_SAMPLE, _LEAST_FOUND = 64, 12
# Share of those found that must agree to so much, half-size px.
_LEAST_AGREED, _AGREED = 0.5, 0.75


@compiled
def _best_column(left: Image, right: Image, x: int, y: int, row: int, middle: int) -> float:
    """Return the best correlation of a patch in row ``y`` with patches of another row."""
    best = -1.0
    for place in (x - middle - 1, x - middle + 1):
        if place - 1 >= HALF and place + 1 + HALF < right.shape[1]:
            best = max(best, *correlations(left, right, x, y, place, row))
    return best


@compiled
def _offsets(
    left: Image, right: Image, coarse: Float32Array, side: int, points: Points, out: Array
) -> int:
    """Fill the rows that the right image is lower by at each point that is found, half-size px."""
    height, width = left.shape
    reach = HALF + _ROWS + 1
    count = 0
    for i in range(points.shape[0]):
        x, y = points[i, 0] // 2, points[i, 1] // 2
        row = min(points[i, 1] // side, coarse.shape[0] - 1)
        column = min(points[i, 0] // side, coarse.shape[1] - 1)
        known = coarse[row, column]
        if not known >= 0.0 or not (HALF <= x < width - HALF and reach <= y < height - reach):
            continue
        middle = int(np.rint(0.5 * side * known))
        where = 0
        above = _best_column(left, right, x, y, y - 1, middle)
        best = _best_column(left, right, x, y, y, middle)
        below = _best_column(left, right, x, y, y + 1, middle)
        while max(above, below) > best and abs(where) < _ROWS:
            if below > above:
                where += 1
                above, best = best, below
                below = _best_column(left, right, x, y, y + where + 1, middle)
            else:
                where -= 1
                below, best = best, above
                above = _best_column(left, right, x, y, y + where - 1, middle)
        curvature = 2.0 * best - above - below
        if best < _LEAST_ALIKE or max(above, below) > best or not curvature > 0.0:
            continue
        out[count] = where + 0.5 * (below - above) / curvature
        count += 1
    return count


def row_offset(left: Image, right: Image, coarse: Float32Array, side: int, points: Points) -> float:
    """Measure how much lower the right image shows what the left one shows, px of the full size.

    Args:
        left, right: at half the size, (H // 2, W // 2) uint8.
        coarse: disparities of coarse pixels, (h, w) float32, coarse px, NaN unknown.
        side: of a coarse pixel, px.
        points: (N, 2) int64, x y in the left image; some of them are looked at.

    Returns:
        The median over the patches found; 0 where they are too few, or do not agree.
    """
    if not coarse.size or not len(points):
        return 0.0
    some = points[:: max(1, len(points) // _SAMPLE)]
    out = np.empty(len(some))
    found = out[: _offsets(left, right, coarse, side, some, out)]
    if len(found) < _LEAST_FOUND:
        return 0.0
    middle = float(np.median(found))
    agreed = np.mean(np.abs(found - middle) < _AGREED)
    return 2.0 * middle if agreed >= _LEAST_AGREED else 0.0
