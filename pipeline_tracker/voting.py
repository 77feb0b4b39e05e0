"""Contribution of segments to lines (4.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]

# An angle on the threshold is left to the comparison of cosines, rad.
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
) -> float:
    """Let segment i contribute to the places of a line where it is better than those before it.

    Args:
        segments: (N, 4), px.
        i: which of them.
        line: see ``line_support``.
        along: unit direction of the line, x y, and its length, px.
        distance: R, px.
        least_cosine: that of A.
        cells: best contribution to each pixel of the line so far, changed.

    Returns:
        By how much the sum of all cells grows.
    """
    x0, y0 = line[0], line[1]
    ux, uy, length = along
    mx = 0.5 * (segments[i, 0] + segments[i, 2]) - x0
    my = 0.5 * (segments[i, 1] + segments[i, 3]) - y0
    r = abs(mx * uy - my * ux)
    if not r <= distance:
        return 0.0
    sx = segments[i, 2] - segments[i, 0]
    sy = segments[i, 3] - segments[i, 1]
    own = np.sqrt(sx * sx + sy * sy)
    if not (own > 0.0 and abs(sx * ux + sy * uy) >= least_cosine * own):
        return 0.0
    low, high = _interval_on(segments, i, x0, y0, ux, uy, length)
    if not high > low:
        return 0.0
    value = 1.0 - r / distance
    first, last = int(low), min(int(high), int(length))
    more = _raise(cells, first, value * (min(high, first + 1.0) - low))
    for k in range(first + 1, last):
        more += _raise(cells, k, value)
    if last > first:
        more += _raise(cells, last, value * (high - last))
    return more


@compiled
def _raise(cells: Array, k: int, value: float) -> float:
    """Raise a cell to a value, if it is below, and return by how much."""
    more = value - cells[k]
    if not more > 0.0:
        return 0.0
    cells[k] = value
    return float(more)


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
    scratch[: int(along[2]) + 1] = 0.0
    total = 0.0
    least_cosine = np.cos(angle)
    for i in range(segments.shape[0]):
        total += _contribute(segments, i, line, along, distance, least_cosine, scratch)
    return total, along[2]


def sorted_by_angle(segments: Float32Array) -> tuple[Float32Array, Array]:
    """Sort segments by their direction, for ``support_of_sorted``.

    Args:
        segments: (N, 4) float32, px; those that are points, or not finite, are left out.

    Returns:
        (M, 4) float32, and their angles, (M,), 0 to below π, ascending.
    """
    ends = segments.astype(np.float64)
    ways = ends[:, 2:] - ends[:, :2]
    angles = np.mod(np.arctan2(ways[:, 1], ways[:, 0]), np.pi)
    usable = np.isfinite(angles) & (np.abs(ways).sum(axis=1) > 0.0)
    chosen = np.flatnonzero(usable)
    order = chosen[np.argsort(angles[chosen], kind="stable")]
    return np.ascontiguousarray(segments[order], np.float32), angles[order]


@compiled
def support_of_sorted(
    segments: Float32Array,
    angles: Array,
    line: Array,
    distance: float,
    angle: float,
    scratch: Array,
) -> float:
    """Sum the contributions to a line as ``line_support`` does, of segments sorted by direction.

    Only those that run as the line does are looked at, which pays where many lines are voted for.

    Args:
        segments, angles: as ``sorted_by_angle`` returns them.
        line, distance, angle, scratch: see ``line_support``.
    """
    along = _direction(line)
    if not along[2] > 0.0:
        return 0.0
    scratch[: int(along[2]) + 1] = 0.0
    middle = np.arctan2(along[1], along[0]) % np.pi
    least_cosine = np.cos(angle)
    total = 0.0
    # Directions go round: those near 0 and near π are alike.
    for turn in (-np.pi, 0.0, np.pi):
        low, high = middle + turn - angle - _ROUNDING, middle + turn + angle + _ROUNDING
        if high < 0.0 or low > np.pi:
            continue
        i = np.searchsorted(angles, low)
        while i < angles.shape[0] and angles[i] <= high:
            total += _contribute(segments, i, line, along, distance, least_cosine, scratch)
            i += 1
    return total


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
