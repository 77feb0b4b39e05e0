"""One-pixel edges to pixel chains, broken lines and straight segments (4.1.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled, compiled_sums
from pipeline_tracker.vectorization.edges import NO_EDGE, STRONG, ridge_offset

Int16Array = NDArray[np.int16]
Float32Array = NDArray[np.float32]
Places = NDArray[np.int64]

# Neighbours going round, so that index +- 1 is 45 degrees further.
_STEP_X = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int64)
_STEP_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int64)
# The neighbour in a direction whose signs are x and y: at 3 y + x + 4. None is at 4.
_DIRECTIONS = np.array([5, 6, 7, 4, 0, 0, 3, 2, 1], np.int64)
# An edge goes on straight first, then 45 and 90 degrees to each side.
_TURNS = np.array([0, 1, -1, 2, -2], np.int64)
# The first turn that is open, by a bit for each.
_FIRST_TURN = np.array([0] + [(n & -n).bit_length() - 1 for n in range(1, 32)], np.int64)
# Tangent of 22.5 degrees.
_TANGENT = np.float32(np.sqrt(2.0) - 1.0)


@compiled
def _heading(gx: float, gy: float) -> int:
    """Return the direction (0 to 7) of an edge that has its brighter side to the right.

    As one looks at the picture: image y is down.
    """
    ax, ay = abs(gx), abs(gy)
    x = 0 if ay <= _TANGENT * ax else (1 if gy > 0.0 else -1)
    y = 0 if ax <= _TANGENT * ay else (-1 if gx > 0.0 else 1)
    return int(_DIRECTIONS[3 * y + x + 4])


@compiled
def _follow(
    ridge: NDArray[np.uint8],
    dx: Int16Array,
    dy: Int16Array,
    place: int,
    steps: Places,
    heading: int,
    out: Places,
    side: int,
) -> int:
    """Follow an edge from a pixel and take its pixels from the ridge.

    It goes on to edges of a similar gradient alone (within 45 degrees), so that a chain never
    changes from one side of a line to the other.

    Args:
        ridge, dx, dy: flat.
        place: flat index of the pixel.
        steps: (8,) from a pixel to its neighbours, flat.
        heading: direction in which the edge came, 0 to 7.
        out: (2 N + 1,), filled with flat indices from its middle on, at most N.
        side: 1 or -1, to which side of the middle.

    Returns:
        The number of pixels taken.
    """
    middle = out.shape[0] // 2
    gx, gy = int(dx[place]), int(dy[place])
    square = gx * gx + gy * gy
    for count in range(middle):
        # All five are read at once, without asking first whether they are needed: which of them
        # is an edge cannot be foreseen by the processor, and a wrong guess costs more than all.
        # No place is negative: an edge is never in the border.
        opened = 0
        for i in range(5):
            there = place + steps[(heading + _TURNS[i]) & 7]
            opened |= int(ridge[np.uint64(there)] != NO_EDGE) << i
        there = direction = hx = hy = other = 0
        while opened:
            direction = (heading + _TURNS[_FIRST_TURN[opened]]) & 7
            there = place + steps[direction]
            hx, hy = int(dx[np.uint64(there)]), int(dy[np.uint64(there)])
            along, other = gx * hx + gy * hy, hx * hx + hy * hy
            if along >= 0 and 2 * along * along >= square * other:
                break
            opened &= opened - 1
        if not opened:
            return count
        place, heading = there, direction
        gx, gy, square = hx, hy, other
        ridge[np.uint64(place)] = NO_EDGE
        out[np.uint64(middle + side * (count + 1))] = place
    return int(middle)


@compiled
def _to_ridge(
    dx: Int16Array,
    dy: Int16Array,
    magnitude: Float32Array,
    chain: Places,
    width: int,
    xs: Float32Array,
    ys: Float32Array,
) -> None:
    """Fill the points of a chain, px, each moved along its gradient to the ridge.

    Args:
        dx, dy, magnitude: flat.
        chain: (N,) flat indices.
        width: of a row.
        xs, ys: (N,) at least, filled.
    """
    for i in range(chain.shape[0]):
        place = chain[i]
        shift = ridge_offset(dx, dy, magnitude, place, width) / magnitude[np.uint64(place)]
        y = place // width
        xs[i] = np.float32(place - y * width) + shift * np.float32(dx[np.uint64(place)])
        ys[i] = np.float32(y) + shift * np.float32(dy[np.uint64(place)])


@compiled
def _split(
    xs: Float32Array,
    ys: Float32Array,
    tolerance: float,
    breaks: Places,
    keep: NDArray[np.uint8],
    stack: Places,
) -> int:
    """Split a chain where it deviates from its chord (Ramer, Douglas, Peucker).

    Args:
        xs, ys: (N,) float32, px.
        tolerance: px.
        breaks: (N,) at least, filled with the indices of the corners, ends included, ascending.
        keep: (N,) at least, to work in.
        stack: (2 N,) at least, to work in.

    Returns:
        The number of corners.
    """
    n = xs.shape[0]
    keep[:n] = 0
    keep[0] = keep[n - 1] = 1
    stack[0], stack[1] = 0, n - 1
    depth = 2
    while depth > 0:
        depth -= 2
        first, last = stack[depth], stack[depth + 1]
        if last - first < 2:
            continue
        x, y = xs[first], ys[first]
        ux, uy = xs[last] - x, ys[last] - y
        norm = np.sqrt(ux * ux + uy * uy)
        # Where the ends meet there is no chord: distances are then those from the end.
        closed = norm == np.float32(0)
        worst, where = np.float32(-1), first
        for i in range(first + 1, last):
            px, py = xs[i] - x, ys[i] - y
            d = px * px + py * py if closed else abs(px * uy - py * ux)
            if d > worst:
                worst, where = d, i
        if worst > (tolerance * tolerance if closed else tolerance * norm):
            keep[where] = 1
            stack[depth], stack[depth + 1] = first, where
            stack[depth + 2], stack[depth + 3] = where, last
            depth += 4
    count = 0
    for i in range(n):
        if keep[i] == 1:
            breaks[count] = i
            count += 1
    return count


@compiled_sums
def _fit(xs: Float32Array, ys: Float32Array, first: int, last: int, out: Float32Array) -> float:
    """Fit a line to points ``first..last`` (least squares across it) and clip it to them.

    Args:
        xs, ys: (N,) float32, px.
        first, last: first and last index, both included.
        out: (4,) filled with x1 y1 x2 y2.

    Returns:
        The segment's length, px.
    """
    n = last - first + 1
    # From the first point: float32 holds the sums of small numbers better.
    x, y = xs[first], ys[first]
    sx = sy = sxx = sxy = syy = np.float32(0)
    for i in range(first, last + 1):
        a, b = xs[i] - x, ys[i] - y
        sx += a
        sy += b
        sxx += a * a
        sxy += a * b
        syy += b * b
    mx, my = float(sx) / n, float(sy) / n
    xx, xy, yy = float(sxx) - n * mx * mx, float(sxy) - n * mx * my, float(syy) - n * my * my
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    ux, uy = np.cos(angle), np.sin(angle)
    chord_x, chord_y = float(xs[last] - x), float(ys[last] - y)
    if chord_x * ux + chord_y * uy < 0.0:
        ux, uy = -ux, -uy
    a = -mx * ux - my * uy
    b = (chord_x - mx) * ux + (chord_y - my) * uy
    out[0], out[1] = x + mx + a * ux, y + my + a * uy
    out[2], out[3] = x + mx + b * ux, y + my + b * uy
    return float(abs(b - a))


@compiled
def trace_segments(
    ridge: NDArray[np.uint8],
    dx: Int16Array,
    dy: Int16Array,
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
    # To each side of where a chain begins.
    longest = 4 * (height + width)
    most = 2 * longest + 1
    chain, breaks = np.empty(most, np.int64), np.empty(most, np.int64)
    stack = np.empty(2 * most, np.int64)
    xs, ys, keep = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.uint8)
    one = np.empty(4, np.float32)
    steps = _STEP_Y * width + _STEP_X
    flat, flat_x, flat_y = ridge.ravel(), dx.ravel(), dy.ravel()
    flat_magnitude = magnitude.ravel()
    for start in range(flat.size):
        if flat[start] != STRONG:
            continue
        flat[start] = NO_EDGE
        heading = _heading(flat_x[start], flat_y[start])
        chain[longest] = start
        ahead = _follow(flat, flat_x, flat_y, start, steps, heading, chain, 1)
        behind = _follow(flat, flat_x, flat_y, start, steps, (heading + 4) & 7, chain, -1)
        n = behind + 1 + ahead
        if n < min_length * 0.7:
            continue
        pixels = chain[longest - behind : longest + 1 + ahead]
        _to_ridge(flat_x, flat_y, flat_magnitude, pixels, width, xs, ys)
        corners = _split(xs[:n], ys[:n], tolerance, breaks, keep, stack)
        for k in range(corners - 1):
            first, last = breaks[k], breaks[k + 1]
            # No fitted segment is longer than its chord.
            chord_x, chord_y = xs[last] - xs[first], ys[last] - ys[first]
            if chord_x * chord_x + chord_y * chord_y < min_length * min_length:
                continue
            if _fit(xs, ys, first, last, one) < min_length:
                continue
            # A chain may have set out the wrong way where an edge begins; the gradient tells.
            middle = (first + last) // 2
            x, y = int(np.rint(xs[middle])), int(np.rint(ys[middle]))
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
