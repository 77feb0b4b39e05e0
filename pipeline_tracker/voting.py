"""Contribution of segments to lines (4.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled, compiled_sums
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]

# Distances so near to the threshold are computed once more, px.
_ROUNDING = 1e-6


@compiled
def _interval_on(
    segments: Float32Array, i: int, x0: float, y0: float, ux: float, uy: float, length: float
) -> tuple[float, float]:
    """Return where segment i projects on a finite line: from, to, px; empty where to <= from."""
    a = (segments[i, 0] - x0) * ux + (segments[i, 1] - y0) * uy
    b = (segments[i, 2] - x0) * ux + (segments[i, 3] - y0) * uy
    if a > b:
        a, b = b, a
    return max(a, 0.0), min(b, length)


@compiled
def _contribute(
    segments: Float32Array,
    i: int,
    line: Array,
    along: tuple[float, float, float],
    distance: float,
    least_cosine: float,
    cells: Array,
) -> None:
    """Let segment i contribute to the places of a line where it is better than those before it.

    Args:
        segments: (N, 4), px.
        i: which of them.
        line: see ``line_support``.
        along: unit direction of the line, x y, and its length, px.
        distance: R, px.
        least_cosine: that of A.
        cells: best contribution to each pixel of the line so far, changed.
    """
    x0, y0 = line[0], line[1]
    ux, uy, length = along
    mx = 0.5 * (segments[i, 0] + segments[i, 2]) - x0
    my = 0.5 * (segments[i, 1] + segments[i, 3]) - y0
    r = abs(mx * uy - my * ux)
    if not r <= distance:
        return
    sx = segments[i, 2] - segments[i, 0]
    sy = segments[i, 3] - segments[i, 1]
    own = np.sqrt(sx * sx + sy * sy)
    if not (own > 0.0 and abs(sx * ux + sy * uy) >= least_cosine * own):
        return
    low, high = _interval_on(segments, i, x0, y0, ux, uy, length)
    if not high > low:
        return
    value = 1.0 - r / distance
    first, last = int(low), min(int(high), int(length))
    cells[first] = max(cells[first], value * (min(high, first + 1.0) - low))
    for k in range(first + 1, last):
        cells[k] = max(cells[k], value)
    if last > first:
        cells[last] = max(cells[last], value * (high - last))


@compiled_sums
def _sum(cells: Array) -> float:
    total = 0.0
    for k in range(cells.shape[0]):
        total += cells[k]
    return total


@compiled
def _direction(line: Array) -> tuple[float, float, float]:
    """Return the unit direction, x y, of a finite line and its length, px; 0 of a point."""
    ux = line[2] - line[0]
    uy = line[3] - line[1]
    length = np.sqrt(ux * ux + uy * uy)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return ux / length, uy / length, length


@compiled
def line_support(
    segments: Float32Array, line: Array, distance: float, angle: float, scratch: Array
) -> tuple[float, float]:
    """Sum the contributions of segments to one finite line (4.1.3).

    Each segment contributes (1 - r / R) · l · cos α, with r the distance of its midpoint from the
    line, l · cos α the length of its projection inside the line, α its angle to it. Where segments
    overlap, each place of the line counts once, with the best contribution found there.

    Args:
        segments: (N, 4) float32, px.
        line: x1 y1 x2 y2 of the finite line, px.
        distance: R, px.
        angle: A, rad.
        scratch: at least ``ceil(length) + 2`` numbers of room.

    Returns:
        Sum of contributions, px, and the line's own length, px.
    """
    along = _direction(line)
    if not along[2] > 0.0:
        return 0.0, 0.0
    cells = scratch[: int(along[2]) + 1]
    cells[:] = 0.0
    least_cosine = np.cos(angle)
    for i in range(segments.shape[0]):
        _contribute(segments, i, line, along, distance, least_cosine, cells)
    return _sum(cells), along[2]


def middles_of(segments: Float32Array) -> Array:
    """Return x and y of the middles of segments, (2, N), px, for ``support_by_middles``."""
    ends = segments.astype(np.float64)
    return np.ascontiguousarray(0.5 * (ends[:, :2] + ends[:, 2:]).T)


@compiled
def support_by_middles(
    segments: Float32Array,
    middles: Array,
    line: Array,
    distance: float,
    angle: float,
    scratch: Array,
    off: Array,
) -> float:
    """Sum the contributions to a line as ``line_support`` does, where many lines are voted for.

    Most segments are too far from a line: their middles are looked at first, several at a time.

    Args:
        segments, middles: (N, 4) and what ``middles_of`` makes of them.
        line, distance, angle, scratch: see ``line_support``.
        off: (N,), overwritten.
    """
    along = _direction(line)
    if not along[2] > 0.0:
        return 0.0
    ux, uy = along[0], along[1]
    level = line[0] * uy - line[1] * ux
    for i in range(off.shape[0]):
        off[i] = abs(middles[0, i] * uy - middles[1, i] * ux - level)
    cells = scratch[: int(along[2]) + 1]
    clear = False
    least_cosine = np.cos(angle)
    for i in range(off.shape[0]):
        if off[i] <= distance + _ROUNDING:
            if not clear:
                cells[:] = 0.0
                clear = True
            _contribute(segments, i, line, along, distance, least_cosine, cells)
    return _sum(cells) if clear else 0.0


def contribution(segment: Float32Array, line: Array, distance: float, angle: float) -> float:
    """Return w of one segment for an infinite line (4.1.3).

    Args:
        segment: (4,) float32, x1 y1 x2 y2, px.
        line: (a, b, c), a² + b² = 1.
        distance: R, px.
        angle: A, rad.
    """
    x1, y1, x2, y2 = (float(v) for v in segment)
    length = float(np.hypot(x2 - x1, y2 - y1))
    r = abs(line[0] * (x1 + x2) / 2 + line[1] * (y1 + y2) / 2 + line[2])
    if not (length > 0.0 and r <= distance):
        return 0.0
    cosine = abs((x2 - x1) * -line[1] + (y2 - y1) * line[0]) / length
    if not cosine >= np.cos(angle):
        return 0.0
    return float((1.0 - r / distance) * length * cosine)
