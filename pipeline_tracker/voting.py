"""Contribution of segments to lines (4.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]


@compiled
def _interval_on(
    segment: Float32Array, x0: float, y0: float, ux: float, uy: float, length: float
) -> tuple[float, float]:
    """Return where a segment projects on a finite line: from, to, px; empty where to <= from."""
    a = (segment[0] - x0) * ux + (segment[1] - y0) * uy
    b = (segment[2] - x0) * ux + (segment[3] - y0) * uy
    if a > b:
        a, b = b, a
    return max(a, 0.0), min(b, length)


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
    x0, y0 = line[0], line[1]
    ux = line[2] - x0
    uy = line[3] - y0
    length = np.sqrt(ux * ux + uy * uy)
    if not length > 0.0:
        return 0.0, 0.0
    ux /= length
    uy /= length
    cells = int(length) + 1
    for k in range(cells):
        scratch[k] = 0.0
    least_cosine = np.cos(angle)
    for i in range(segments.shape[0]):
        s = segments[i]
        mx = 0.5 * (s[0] + s[2]) - x0
        my = 0.5 * (s[1] + s[3]) - y0
        r = abs(mx * uy - my * ux)
        if not r <= distance:
            continue
        sx = s[2] - s[0]
        sy = s[3] - s[1]
        own = np.sqrt(sx * sx + sy * sy)
        if not (own > 0.0 and abs(sx * ux + sy * uy) >= least_cosine * own):
            continue
        low, high = _interval_on(s, x0, y0, ux, uy, length)
        if not high > low:
            continue
        value = 1.0 - r / distance
        for k in range(int(low), min(int(high), cells - 1) + 1):
            inside = min(high, k + 1.0) - max(low, float(k))
            scratch[k] = max(scratch[k], value * inside)
    total = 0.0
    for k in range(cells):
        total += scratch[k]
    return total, length


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
