"""Nearest neighbours of places in a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Places are sorted into square cells of about so many; of a thin row, at most so many cells along.
_PER_CELL, _MOST_CELLS = 1.5, 200


def neighbours(places: Array, chosen: Indices, count: int) -> Indices:
    """Find the nearest neighbours of some places.

    Args:
        places: (N, 2 or more), x and y first, finite.
        chosen: (K,) indices of those whose neighbours are wanted.
        count: how many each, below N.

    Returns:
        (K, count) indices, the nearest first; a place is not its own neighbour.
    """
    found = np.empty((len(chosen), count), np.int64)
    _find(places, chosen, found)
    return found


@compiled
def _find(places: Array, chosen: Indices, found: Indices) -> None:
    """Fill (K, count), see ``neighbours``."""
    n = places.shape[0]
    low, high = np.array([np.inf, np.inf]), np.array([-np.inf, -np.inf])
    for i in range(n):
        for c in range(2):
            low[c], high[c] = min(low[c], places[i, c]), max(high[c], places[i, c])
    width, height = high[0] - low[0], high[1] - low[1]
    cell = np.sqrt(_PER_CELL * width * height / n)
    cell = max(cell, max(width, height) / _MOST_CELLS, 1e-9)
    columns, rows = int(width / cell) + 1, int(height / cell) + 1
    of_place, order = np.empty(n, np.int64), np.empty(n, np.int64)
    starts = np.zeros(columns * rows + 1, np.int64)
    _sort_by_cell(places, low, cell, columns, of_place, order, starts)
    _search(places, chosen, of_place, order, starts, columns, cell, found)


@compiled
def _sort_by_cell(
    places: Array,
    corner: Array,
    cell: float,
    columns: int,
    of_place: Indices,
    order: Indices,
    starts: Indices,
) -> None:
    """Sort places by their cells, by counting; see ``_search``. ``starts`` comes in as zeros."""
    for i in range(places.shape[0]):
        column = int((places[i, 0] - corner[0]) / cell)
        row = int((places[i, 1] - corner[1]) / cell)
        of_place[i] = row * columns + column
        starts[of_place[i] + 1] += 1
    for k in range(1, starts.shape[0]):
        starts[k] += starts[k - 1]
    filled = starts.copy()
    for i in range(places.shape[0]):
        order[filled[of_place[i]]] = i
        filled[of_place[i]] += 1


@compiled
def _search(
    places: Array,
    chosen: Indices,
    of_place: Indices,
    order: Indices,
    starts: Indices,
    columns: int,
    cell: float,
    found: Indices,
) -> None:
    """Search ring after ring of cells around each place, until no nearer one can come.

    Args:
        places, chosen: see ``neighbours``.
        of_place: number of each place's cell, (N,).
        order: places sorted by cell, (N,).
        starts: where in ``order`` each cell begins, (cells + 1,).
        columns: cells in a row.
        cell: side of a cell.
        found: (K, count), filled.
    """
    rows = (starts.shape[0] - 1) // columns
    count = found.shape[1]
    squares = np.empty(count)
    for j in range(chosen.shape[0]):
        i = chosen[j]
        row, column = of_place[i] // columns, of_place[i] % columns
        squares[:] = np.inf
        for ring in range(max(rows, columns)):
            # All that is not within the rings before is further off than they reach.
            reached = (ring - 1) * cell
            if ring > 0 and squares[count - 1] <= reached * reached:
                break
            for r in range(max(0, row - ring), min(rows, row + ring + 1)):
                edge = abs(r - row) == ring
                for c in range(max(0, column - ring), min(columns, column + ring + 1)):
                    if not (edge or abs(c - column) == ring):
                        continue
                    for k in range(starts[r * columns + c], starts[r * columns + c + 1]):
                        _insert(places, i, order[k], squares, found, j)


@compiled
def _insert(places: Array, i: int, other: int, squares: Array, found: Indices, j: int) -> None:
    """Put another place among the nearest of place i, row j, if it is one of them."""
    if other == i:
        return
    x, y = places[other, 0] - places[i, 0], places[other, 1] - places[i, 1]
    square = x * x + y * y
    k = squares.shape[0] - 1
    if not square <= squares[k]:
        return
    while k > 0 and square <= squares[k - 1]:
        squares[k] = squares[k - 1]
        found[j, k] = found[j, k - 1]
        k -= 1
    squares[k] = square
    found[j, k] = other
