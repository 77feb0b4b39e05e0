"""One-pixel edges to pixel chains, broken lines and straight segments (4.1.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.vectorization.edges import NO_EDGE, STRONG, ridge_offset

Float32Array = NDArray[np.float32]

# Neighbours going round, so that index +- 1 is 45 degrees further.
_STEP_X = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int64)
_STEP_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int64)


@compiled
def _next_pixel(
    ridge: NDArray[np.uint8],
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    place: int,
    steps: NDArray[np.int64],
    heading: int,
) -> int:
    """Return the direction (0 to 7) in which an edge goes on from a pixel, -1 where it ends.

    Straight on first, then 45 and 90 degrees to each side; only to edges of a similar gradient
    (within 45 degrees), so that a chain never changes from one side of a line to the other.

    Args:
        ridge, dx, dy: flat.
        place: flat index of the pixel.
        steps: (8,) from a pixel to its neighbours, flat.
        heading: direction in which the edge came.
    """
    gx = float(dx[place])
    gy = float(dy[place])
    square = 0.5 * (gx * gx + gy * gy)
    for turn in (0, 1, -1, 2, -2):
        k = (heading + turn) & 7
        there = place + steps[k]
        if ridge[there] == NO_EDGE:
            continue
        hx = float(dx[there])
        hy = float(dy[there])
        along = gx * hx + gy * hy
        if along >= 0.0 and along * along >= square * (hx * hx + hy * hy):
            return k
    return -1


@compiled
def _follow(
    ridge: NDArray[np.uint8],
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    place: int,
    steps: NDArray[np.int64],
    heading: int,
    out: NDArray[np.int64],
) -> int:
    """Follow an edge from a pixel, take its pixels from the ridge to ``out``; flat."""
    count = 0
    while count < out.shape[0]:
        k = _next_pixel(ridge, dx, dy, place, steps, heading)
        if k < 0:
            break
        place += steps[k]
        ridge[place] = NO_EDGE
        out[count] = place
        count += 1
        heading = k
    return count


@compiled
def _split(points: Float32Array, tolerance: float, breaks: NDArray[np.int64]) -> int:
    """Split a chain where it deviates from its chord (Ramer, Douglas, Peucker).

    Args:
        points: (N, 2) float32, px.
        tolerance: px.
        breaks: (N,) filled with the indices of the corners, ends included, ascending.

    Returns:
        The number of corners.
    """
    n = points.shape[0]
    keep = np.zeros(n, np.uint8)
    keep[0] = 1
    keep[n - 1] = 1
    stack = np.empty((n + 2, 2), np.int64)
    stack[0, 0] = 0
    stack[0, 1] = n - 1
    depth = 1
    while depth > 0:
        depth -= 1
        first = stack[depth, 0]
        last = stack[depth, 1]
        if last - first < 2:
            continue
        ux = points[last, 0] - points[first, 0]
        uy = points[last, 1] - points[first, 1]
        norm = np.sqrt(ux * ux + uy * uy)
        # Where the ends meet there is no chord: distances are then those from the end.
        closed = norm == 0.0
        worst = -1.0
        where = -1
        for i in range(first + 1, last):
            px = points[i, 0] - points[first, 0]
            py = points[i, 1] - points[first, 1]
            d = px * px + py * py if closed else abs(px * uy - py * ux)
            if d > worst:
                worst = d
                where = i
        if worst > (tolerance * tolerance if closed else tolerance * norm):
            keep[where] = 1
            stack[depth, 0] = first
            stack[depth, 1] = where
            stack[depth + 1, 0] = where
            stack[depth + 1, 1] = last
            depth += 2
    count = 0
    for i in range(n):
        if keep[i] == 1:
            breaks[count] = i
            count += 1
    return count


@compiled
def _fit(points: Float32Array, first: int, last: int, out: Float32Array) -> float:
    """Fit a line to ``points[first..last]`` (least squares across it) and clip it to them.

    Args:
        points: (N, 2) float32, px.
        first, last: first and last index, both included.
        out: (4,) filled with x1 y1 x2 y2.

    Returns:
        The segment's length, px.
    """
    n = last - first + 1
    mx = 0.0
    my = 0.0
    for i in range(first, last + 1):
        mx += points[i, 0]
        my += points[i, 1]
    mx /= n
    my /= n
    xx = 0.0
    xy = 0.0
    yy = 0.0
    for i in range(first, last + 1):
        a = points[i, 0] - mx
        b = points[i, 1] - my
        xx += a * a
        xy += a * b
        yy += b * b
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    ux = np.cos(angle)
    uy = np.sin(angle)
    chord = (points[last, 0] - points[first, 0]) * ux + (points[last, 1] - points[first, 1]) * uy
    if chord < 0:
        ux = -ux
        uy = -uy
    a = (points[first, 0] - mx) * ux + (points[first, 1] - my) * uy
    b = (points[last, 0] - mx) * ux + (points[last, 1] - my) * uy
    out[0] = mx + a * ux
    out[1] = my + a * uy
    out[2] = mx + b * ux
    out[3] = my + b * uy
    return float(abs(b - a))


@compiled
def trace_segments(
    ridge: NDArray[np.uint8],
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    magnitude: Float32Array,
    tolerance: float,
    min_length: float,
) -> Float32Array:
    """Trace edges into chains and chains into straight segments with sub-pixel ends.

    A chain starts at a strong pixel and goes on over all edges joined to it (hysteresis); it ends
    at junctions, because each pixel belongs to one chain.

    Args:
        ridge: (H, W) uint8, as ``suppress_non_maxima`` fills it; taken pixels are set to NO_EDGE.
        dx, dy: derivatives, (H, W) int16.
        magnitude: (H, W) float32.
        tolerance: a broken line is split where it deviates by more, px.
        min_length: shorter segments are dropped, px.

    Returns:
        (N, 4) float32, x1 y1 x2 y2, px; the brighter side is to the right of the direction
        from 1 to 2 as one looks at the picture.
    """
    height, width = ridge.shape
    capacity = 1024
    segments = np.empty((capacity, 4), np.float32)
    found = 0
    longest = 4 * (height + width)
    ahead = np.empty(longest, np.int64)
    behind = np.empty(longest, np.int64)
    points = np.empty((2 * longest + 1, 2), np.float32)
    breaks = np.empty(2 * longest + 1, np.int64)
    one = np.empty(4, np.float32)
    steps = _STEP_Y * width + _STEP_X
    flat, flat_x, flat_y = ridge.ravel(), dx.ravel(), dy.ravel()
    flat_magnitude = magnitude.ravel()
    for start in range(flat.size):
        if flat[start] != STRONG:
            continue
        flat[start] = NO_EDGE
        # Along the edge, with the gradient (the brighter side) to the right: image y is down.
        angle = np.arctan2(-float(flat_x[start]), float(flat_y[start]))
        heading = int(np.rint(angle / (np.pi / 4))) & 7
        n_ahead = _follow(flat, flat_x, flat_y, start, steps, heading, ahead)
        n_behind = _follow(flat, flat_x, flat_y, start, steps, (heading + 4) & 7, behind)
        n = n_behind + 1 + n_ahead
        if n < min_length * 0.7:
            continue
        for i in range(n):
            if i < n_behind:
                place = behind[n_behind - 1 - i]
            elif i == n_behind:
                place = start
            else:
                place = ahead[i - n_behind - 1]
            shift = ridge_offset(flat_x, flat_y, flat_magnitude, place, width)
            shift /= flat_magnitude[place]
            points[i, 0] = place % width + shift * flat_x[place]
            points[i, 1] = place // width + shift * flat_y[place]
        corners = _split(points[:n], tolerance, breaks)
        for k in range(corners - 1):
            if _fit(points, breaks[k], breaks[k + 1], one) < min_length:
                continue
            # A chain may have set out the wrong way where an edge begins; the gradient tells.
            middle = (breaks[k] + breaks[k + 1]) // 2
            x = int(np.rint(points[middle, 0]))
            y = int(np.rint(points[middle, 1]))
            if (one[2] - one[0]) * dy[y, x] < (one[3] - one[1]) * dx[y, x]:
                one[0], one[1], one[2], one[3] = one[2], one[3], one[0], one[1]
            if found == capacity:
                capacity *= 2
                grown = np.empty((capacity, 4), np.float32)
                grown[:found] = segments
                segments = grown
            segments[found] = one
            found += 1
    return segments[:found].copy()
