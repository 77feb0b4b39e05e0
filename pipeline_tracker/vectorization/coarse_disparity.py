"""Disparities at a fraction of the size, everywhere, and where to look closer.

Points are chosen by what stands out of the bed in this pair alone, without any prediction: a pair
gives the same points whatever came before.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

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
# Heights are averaged over so many points of the sparse grid along each side.
_SMOOTH = 3
# Fewer points tell no plane.
_LEAST_POINTS = 20


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
    xs, ys = np.meshgrid(columns[1::_FINER], rows[1::_FINER])
    return np.stack((xs.ravel(), ys.ravel()), axis=1).astype(np.int64)


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
    chosen = np.zeros((len(rows), len(columns)), np.bool_)
    heights = _heights(sparse.reshape(shape))
    if heights is not None:
        known = heights[np.isfinite(heights)]
        if len(known):
            # NaN is not above.
            raised = heights >= np.quantile(known, 1.0 - _RAISED_SHARE)
            whole = np.repeat(np.repeat(raised, _FINER, axis=0), _FINER, axis=1)
            part = whole[: len(rows), : len(columns)]
            chosen[: part.shape[0], : part.shape[1]] = part
    chosen[1::_FINER, 1::_FINER] = False
    row, column = np.nonzero(chosen)
    return np.stack((columns[column], rows[row]), axis=1)


def _heights(disparities: Array) -> Float32Array | None:
    """Return how far each point of a grid stands out of the plane through the bed, averaged.

    A plane in space is a plane in disparities. NaN where nothing is known.
    """
    ys, xs = np.nonzero(np.isfinite(disparities))
    if len(xs) < _LEAST_POINTS:
        return None
    values = disparities[ys, xs].astype(np.float64)
    design = np.stack((np.ones(len(xs)), xs, ys), axis=1)
    weights: Array = np.ones(len(xs))
    plane: Array = np.zeros(3)
    spread = 0.05
    for _ in range(5):
        weighted = design * weights[:, None]
        normal = weighted.T @ design + 1e-9 * len(xs) * np.eye(3)
        plane = np.asarray(np.linalg.solve(normal, weighted.T @ values), np.float64)
        off = values - design @ plane
        spread = max(1.4826 * float(np.median(np.abs(off))), 0.05)
        weights = 1.0 / (1.0 + np.square(off / spread))
    rows, columns = (np.arange(n) for n in disparities.shape)
    level = plane[0] + plane[1] * columns[None, :] + plane[2] * rows[:, None]
    away = disparities - level.astype(np.float32)
    known = np.isfinite(away).astype(np.float32)
    # Gross mismatches must not pull their neighbours along.
    reach = np.float32(8.0 * spread)
    filled = np.clip(np.nan_to_num(away, nan=0.0), -reach, reach)
    box = (_SMOOTH, _SMOOTH)
    share = cv2.blur(known, box)
    heights = cv2.blur(filled, box) / np.maximum(share, 1e-6)
    heights[share < 0.3] = np.nan
    return np.asarray(heights, np.float32)
