"""Disparities at a fraction of the size, everywhere, and where to look closer.

Points are chosen by what stands out of the bed in this pair alone, without any prediction: a pair
gives the same points whatever came before.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
Points = NDArray[np.int64]
Places = NDArray[np.int64]
Array = NDArray[np.float64]

# The coarse picture is at most this wide, px; in a smaller one a block holds too much at once.
_WIDEST = 200
# Disparities are sought up to this share of the width: at 65 degrees of view down to about three
# baselines away.
LARGEST_DISPARITY = 0.25
_BLOCK, _FRACTIONS = 5, 16.0
# The grid is this much finer where the surface stands out the most, on this share of the picture.
_FINER, _RAISED_SHARE = 3, 0.3
# Fewer points tell no plane; nor does a smaller share of a point and its neighbours its height.
_LEAST_POINTS, _LEAST_KNOWN = 20, 0.3
# However flat the bed: disparities are good to so much, px.
_LEAST_SPREAD = 0.05


def coarse_side(width: int) -> int:
    """Return the side of a coarse pixel, px: 2, 4, 8 and so on, for an image of a width, px."""
    side = 2
    while width > side * _WIDEST:
        side *= 2
    return side


def coarse_disparities(left: Image, right: Image) -> Float32Array:
    """Match everything in two coarse pictures.

    Args:
        left, right: (h, w) uint8.

    Returns:
        (h, w) float32, coarse px; NaN where nothing is known.
    """
    height, width = left.shape
    if min(height, width) < 2 * _BLOCK:
        return np.full(left.shape, np.nan, np.float32)
    # The matcher takes multiples of 16, and leaves out that many columns at the left.
    span = 16 * int(np.ceil(LARGEST_DISPARITY * width / 16.0))
    matcher = cv2.StereoBM.create(span, _BLOCK)
    matcher.setUniquenessRatio(0)
    matcher.setTextureThreshold(0)
    wide = [
        cv2.copyMakeBorder(image, 0, 0, span, 0, cv2.BORDER_REPLICATE) for image in (left, right)
    ]
    found = matcher.compute(*wide)[:, span:].astype(np.float32) / np.float32(_FRACTIONS)
    found[found < 0] = np.nan
    return np.asarray(found, np.float32)


def grid_sides(width: int, height: int, spacing: int) -> tuple[Places, Places]:
    """Return the columns and the rows of a fixed grid, px, centred in the image."""
    columns, rows = (
        np.arange((side % spacing) // 2 + spacing // 2, side, spacing) for side in (width, height)
    )
    return columns, rows


def sparse_points(columns: Places, rows: Places) -> Points:
    """Return every third point of a grid both ways, row by row, (N, 2) int64, x y, px.

    Args:
        columns, rows: of the grid, px.
    """
    xs, ys = columns[1::_FINER], rows[1::_FINER]
    points = np.empty((len(ys), len(xs), 2), np.int64)
    points[..., 0], points[..., 1] = xs, ys[:, None]
    return points.reshape(-1, 2)


def raised_points(columns: Places, rows: Places, sparse: Array) -> Points:
    """Return the points of a grid about those of its sparse points where the surface stands out.

    What lies on the bed stands out of the plane through it. The share of the picture is fixed, so
    the number of points is about the same for every picture.

    Args:
        columns, rows: of the grid, px.
        sparse: disparities at ``sparse_points``, (N,), NaN unknown.

    Returns:
        (M, 2) int64, x y, px; the sparse points are not among them.
    """
    shape = len(rows[1::_FINER]), len(columns[1::_FINER])
    heights = _heights(sparse.reshape(shape))
    known = heights[np.isfinite(heights)]
    if not len(known):
        return np.zeros((0, 2), np.int64)
    least = int(np.ceil((1.0 - _RAISED_SHARE) * (len(known) - 1)))
    return _points_about(heights, float(np.partition(known, least)[least]), columns, rows)


@compiled
def _points_about(heights: Array, least: float, columns: Places, rows: Places) -> Points:
    """Return the grid's points about those sparse ones that are so high, row by row."""
    points = np.empty((len(rows) * len(columns), 2), np.int64)
    count = 0
    for j in range(min(len(rows), _FINER * heights.shape[0])):
        for i in range(min(len(columns), _FINER * heights.shape[1])):
            # NaN is not above.
            raised = heights[j // _FINER, i // _FINER] >= least
            if raised and not (j % _FINER == 1 and i % _FINER == 1):
                points[count, 0], points[count, 1] = columns[i], rows[j]
                count += 1
    return points[:count].copy()


@compiled
def _fit_bed(columns: Array, rows: Array, disparities: Array, plane: Array) -> float:
    """Fit the plane through the bed: a plane in space is a plane in disparities.

    What stands out of it counts the less the farther it is away.

    Args:
        columns, rows, disparities: of the points, (N,).
        plane: (3,), filled: the disparity at column 0 of row 0, its growth by column, and by row.

    Returns:
        How far points are from it, one sigma, px.
    """
    n = len(disparities)
    off = np.zeros(n)
    spread = _LEAST_SPREAD
    normal, right = np.empty((3, 3)), np.empty(3)
    for _ in range(5):
        normal[:, :] = 0.0
        right[:] = 0.0
        for i in range(n):
            ratio = off[i] / spread
            weight = 1.0 / (1.0 + ratio * ratio)
            terms = (1.0, columns[i], rows[i])
            for a in range(3):
                right[a] += weight * terms[a] * disparities[i]
                for b in range(3):
                    normal[a, b] += weight * terms[a] * terms[b]
        # A little is added on the diagonal: points in one row span no plane.
        for a in range(3):
            normal[a, a] += 1e-9 * n
        plane[:] = np.linalg.solve(normal, right)
        for i in range(n):
            off[i] = abs(disparities[i] - plane[0] - plane[1] * columns[i] - plane[2] * rows[i])
        spread = max(1.4826 * np.median(off), _LEAST_SPREAD)
    return float(spread)


@compiled
def _heights(disparities: Array) -> Array:
    """Return how far each point of a grid stands out of the bed, averaged over 3 x 3, px.

    Args:
        disparities: (h, w), px, NaN unknown.

    Returns:
        (h, w), NaN unknown.
    """
    height, width = disparities.shape
    heights = np.full((height, width), np.nan)
    columns, rows, known = np.empty((3, disparities.size))
    n = 0
    for j in range(height):
        for i in range(width):
            if np.isfinite(disparities[j, i]):
                columns[n], rows[n], known[n] = i, j, disparities[j, i]
                n += 1
    if n < _LEAST_POINTS:
        return heights
    plane = np.empty(3)
    # Gross mismatches must not pull their neighbours along.
    reach = 8.0 * _fit_bed(columns[:n], rows[:n], known[:n], plane)
    for j in range(height):
        for i in range(width):
            heights[j, i] = _height_about(disparities, j, i, plane, reach)
    return heights


@compiled
def _height_about(disparities: Array, row: int, column: int, plane: Array, reach: float) -> float:
    """Average how far a point of a grid and its neighbours are from a plane, px; NaN unknown."""
    height, width = disparities.shape
    total, count, places = 0.0, 0, 0
    for j in range(max(row - 1, 0), min(row + 2, height)):
        for i in range(max(column - 1, 0), min(column + 2, width)):
            places += 1
            away = disparities[j, i] - plane[0] - plane[1] * i - plane[2] * j
            if np.isfinite(away):
                total += min(max(away, -reach), reach)
                count += 1
    return total / count if count > 0 and count >= _LEAST_KNOWN * places else np.nan
