"""Hypotheses from surface points alone: a vote for cylinders of known radius.

Beyond the paper: where the contours are silted, fouled or in shadow, the face still shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.jit import compiled
from pipeline_tracker.surface import SurfacePoints

Array = NDArray[np.float64]

_DIRECTIONS = 45
_ELEVATIONS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
# All elevations are voted for at once, in as many lanes as the machine takes at a time; which of
# them is level.
_LANES, _LEVEL = 8, 3
# Between two of the directions tried, the pipe's surface is off by some centimetres at the ends of
# the view: a point counts that is no further off than this share of r, be it ever so exact.
_TOLERANCE_SHARE = 0.15
# Only what rises this far to each side of the axis is taken for the face, as a share of r.
_STRIP_SHARE = 0.85
_LEAST_VOTES = 8
# Lines of a larger cosine, nearer to each other than r, are one hypothesis.
_ALIKE = 0.97
# One point is taken of each cell of the picture, this share of its width: where matches are dense
# they would outvote the bed, and a start needs no more.
_CELL_SHARE = 1.0 / 36.0
# Steps between the positions tried across, as shares of r: of some points' vote, and of all's.
_COARSE_STEP_SHARE, _STEP_SHARE = 0.35, 0.25
_KEPT_EACH = 3
_PLANE_ROUNDS = 5
# Of many points every fourth votes for all directions, but no fewer than this; then all points vote
# for the best so many places.
_COARSE_STEP, _COARSE_POINTS, _FINE = 4, 100, 100
# Steps between the heights tried, as a share of a point's tolerance.
_COARSE_WIDTH, _FINE_WIDTH = 0.8, 0.4


@compiled
def _middle(values: Array, count: int, room: Array) -> float:
    """Return about the median of the first values: that of 16 to 31 of them, sorted in ``room``."""
    step = 1 + count // 16
    n = 0
    for i in range(0, count, step):
        k = n
        while k > 0 and room[k - 1] > values[i]:
            room[k] = room[k - 1]
            k -= 1
        room[k] = values[i]
        n += 1
    return float(0.5 * (room[n // 2] + room[(n - 1) // 2]))


@compiled
def _best_level(
    heights: Array, reaches: Array, count: int, width: float, table: Array, room: Array
) -> tuple[float, float]:
    """Find the height of the axis for which most points of one strip vote.

    Args:
        heights: for each point the height at which the axis would lie, were the point on the
            pipe's upper face, m.
        reaches: tolerance of each, cells of the table.
        count: how many of both are in use.
        width: of a cell of the table, m.
        table: (3, cells), room for votes, points above and points below.
        room: (32,), overwritten.

    Returns:
        Votes less objections, and the height, m.
    """
    cells = table.shape[1]
    votes, aboves, insides = table[0], table[1], table[2]
    # A sample is enough to know where about the strip lies.
    low = _middle(heights, count, room) - 0.5 * cells * width
    for cell in range(cells):
        votes[cell], aboves[cell], insides[cell] = 0.0, 0.0, 0.0
    scale = 1.0 / width
    for k in range(count):
        place, reach = (heights[k] - low) * scale, reaches[k]
        first, last = int(np.ceil(place - reach)), int(np.floor(place + reach))
        # Of the cells before the first this point stands above the pipe; for those after the
        # last it lies inside it, and the camera would look through the pipe.
        if first > 0:
            aboves[min(first, cells) - 1] += 1.0
        if last < cells - 1:
            insides[max(last, -1) + 1] += 1.0
        fall = 0.5 / reach
        for cell in range(max(0, first), min(cells - 1, last) + 1):
            votes[cell] += 1.0 - fall * abs(cell - place)
    above = 0.0
    for cell in range(cells - 1, -1, -1):
        above += aboves[cell]
        votes[cell] -= 0.4 * above
    inside = 0.0
    best = 0
    for cell in range(cells):
        inside += insides[cell]
        votes[cell] -= 0.7 * inside
        if votes[cell] > votes[best]:
            best = cell
    return votes[best], low + best * width


@compiled
def _margin(reaches: Array) -> int:
    """Return how many cells a point may vote for at most: so many are beside those that count."""
    return int(2.0 * np.max(reaches)) + 1


@compiled
def _best_levels(
    heights: Array,
    reaches: Array,
    count: int,
    width: float,
    lows: Array,
    table: Array,
    margin: int,
    votes: Array,
    levels: Array,
) -> None:
    """Find what ``_best_level`` does, for all elevations side by side.

    Args:
        heights: see there, one column for each elevation, (N, lanes), m.
        reaches, count, width: see there.
        lows: height of the first cell, (lanes,), m.
        table: (3, cells + 2 margins, lanes), overwritten; see ``_margin``.
        votes, levels: (lanes,), filled.
    """
    cells = table.shape[1] - 2 * margin
    table[:] = 0.0
    scale = 1.0 / width
    # Without branches: what is off the cells goes into the margins.
    for k in range(count):
        reach = reaches[k]
        fall = 0.5 / reach
        most = int(2.0 * reach) + 1
        for e in range(_LANES):
            place = (heights[k, e] - lows[e]) * scale
            first = int(min(max(np.ceil(place - reach), -1.0 * margin), 1.0 * cells))
            last = int(min(max(np.floor(place + reach), -1.0), cells - 1.0))
            table[1, margin + max(first, 0) - 1, e] += 1.0
            table[2, margin + last + 1, e] += 1.0
            for cell in range(first, first + most):
                off = abs(cell - place)
                table[0, margin + cell, e] += 1.0 - fall * off if off <= reach else 0.0
    above, inside = np.zeros(_LANES), np.zeros(_LANES)
    for cell in range(margin + cells - 1, margin - 1, -1):
        for e in range(_LANES):
            above[e] += table[1, cell, e]
            table[0, cell, e] -= 0.4 * above[e]
    votes[:] = -np.inf
    for cell in range(cells):
        for e in range(_LANES):
            inside[e] += table[2, margin + cell, e]
            score = table[0, margin + cell, e] - 0.7 * inside[e]
            better = score > votes[e]
            votes[e] = score if better else votes[e]
            levels[e] = lows[e] + cell * width if better else levels[e]


@compiled
def _keep(best: Array, votes: float, position: float, level: float, apart: float) -> None:
    """Put a vote among the best of its direction, (K, 3), in the place of a worse one near it."""
    place = best.shape[0] - 1
    for k in range(best.shape[0]):
        if best[k, 0] > 0.0 and abs(best[k, 1] - position) < apart:
            place = k
            break
    if not votes > best[place, 0]:
        return
    while place > 0 and votes > best[place - 1, 0]:
        for c in range(3):
            best[place, c] = best[place - 1, c]
        place -= 1
    best[place, 0], best[place, 1], best[place, 2] = votes, position, level


@compiled
def _vote_across(
    u: Array,
    h: Array,
    reaches: Array,
    radius: float,
    least: int,
    table: Array,
    width: float,
    best: Array,
) -> None:
    """Vote for axis positions in the plane across, for directions that differ in elevation only.

    Args:
        u: place across of each point, ascending, (N,), m.
        h: height of each point for each elevation, (N, lanes), m.
        reaches: tolerance of each point's height, (N,), cells of the table.
        radius: m.
        least: points that a strip must have.
        table, width: see ``_best_levels``.
        best: (E, K, 3) filled with score, position across, height of the axis; score descending.
    """
    n, last = u.shape[0], best.shape[1] - 1
    heights, flat, room = np.empty((n, _LANES)), np.empty(n), np.empty(32)
    lows, votes, levels = np.empty(_LANES), np.empty(_LANES), np.empty(_LANES)
    margin = _margin(reaches)
    # Sums of the heights of all points before one.
    sums = np.zeros((n + 1, _LANES))
    for i in range(n):
        for e in range(_LANES):
            sums[i + 1, e] = sums[i, e] + h[i, e]
    begin = 0
    end = 0
    position = u[0]
    while position <= u[n - 1]:
        while begin < n and u[begin] < position - _STRIP_SHARE * radius:
            begin += 1
        while end < n and u[end] <= position + _STRIP_SHARE * radius:
            end += 1
        count = end - begin
        # A strip has no more votes than points.
        if count >= least and count > np.min(best[:, last, 0]):
            for i in range(begin, end):
                off = u[i] - position
                lift = np.sqrt(radius * radius - off * off)
                flat[i - begin] = h[i, _LEVEL] - lift
                for e in range(_LANES):
                    heights[i - begin, e] = h[i, e] - lift
            # A sample is enough to know where about the strip lies; others differ by the slope.
            middle = _middle(flat, count, room)
            middle -= (sums[end, _LEVEL] - sums[begin, _LEVEL]) / count
            for e in range(_LANES):
                lows[e] = middle + (sums[end, e] - sums[begin, e]) / count
                lows[e] -= (0.5 * table.shape[1] - margin) * width
            _best_levels(
                heights, reaches[begin:end], count, width, lows, table, margin, votes, levels
            )
            for e in range(best.shape[0]):
                if votes[e] > best[e, last, 0]:
                    _keep(best[e], votes[e], position, levels[e], 0.5 * radius)
        position += _COARSE_STEP_SHARE * radius


@compiled
def _vote_directions(
    points: Array,
    tolerance: Array,
    sides: Array,
    ups: Array,
    radius: float,
    least: int,
    out: Array,
) -> None:
    """Vote for each direction.

    Args:
        points: (N, 3), m.
        tolerance: (N,), m.
        sides: unit vectors across each azimuth, level, (A, 3).
        ups: unit vectors across each direction, up, (A, E, 3).
        radius, least: see ``_vote_across``.
        out: (A, E, K, 3) filled, see ``_vote_across``.
    """
    n = points.shape[0]
    width = max(_COARSE_WIDTH * np.median(tolerance), 0.01 * radius)
    cells = max(8, int(4.0 * radius / width))
    table = np.empty((3, cells + 2 * _margin(tolerance / width), _LANES))
    h, reaches = np.empty((n, _LANES)), np.empty(n)
    out[:] = 0.0
    for a in range(sides.shape[0]):
        u = points @ sides[a]
        # Directions of one azimuth have the same places across: they are sorted once.
        order = np.argsort(u, kind="mergesort")
        for k in range(n):
            i = order[k]
            reaches[k] = tolerance[i] / width
            for e in range(_LANES):
                up = ups[a, min(e, ups.shape[1] - 1)]
                h[k, e] = points[i, 0] * up[0] + points[i, 1] * up[1] + points[i, 2] * up[2]
        _vote_across(u[order], h, reaches, radius, least, table, width, out[a])


@compiled
def _vote_again(
    points: Array, tolerance: Array, sides: Array, ups: Array, radius: float, found: Array
) -> None:
    """Vote with all points for what some of them found.

    Args:
        points: (N, 3), m.
        tolerance: (N,), m.
        sides, ups: unit vectors across the direction of each, level and up, (K, 3).
        radius: m.
        found: (K, 3), score, position across, height of the axis: changed to the best of the
            position and of those a step beside it.
    """
    n = points.shape[0]
    width = max(_FINE_WIDTH * np.median(tolerance), 0.01 * radius)
    table = np.empty((3, max(8, int(4.0 * radius / width))))
    heights, reaches, room = np.empty(n), np.empty(n), np.empty(32)
    for k in range(found.shape[0]):
        middle = found[k, 1]
        found[k, 0] = 0.0
        for step in range(-1, 2):
            position = middle + step * _STEP_SHARE * radius
            count = 0
            for i in range(n):
                off = -position
                height = 0.0
                for c in range(3):
                    off += points[i, c] * sides[k, c]
                    height += points[i, c] * ups[k, c]
                if abs(off) <= _STRIP_SHARE * radius:
                    heights[count] = height - np.sqrt(radius * radius - off * off)
                    reaches[count] = tolerance[i] / width
                    count += 1
            if count < _LEAST_VOTES:
                continue
            votes, level = _best_level(heights, reaches, count, width, table, room)
            if votes > found[k, 0]:
                found[k, 0], found[k, 1], found[k, 2] = votes, position, level


def _directions(normal: Array) -> tuple[Array, Array, Array]:
    """Return directions (A, E, 3) around a plane's normal, and the vectors across them.

    Those are level, the same for all elevations of an azimuth, (A, 3), and up, (A, E, 3).
    """
    first = np.cross(normal, np.array([1.0, 0.0, 0.0]))
    if np.linalg.norm(first) < 0.1:
        first = np.cross(normal, np.array([0.0, 1.0, 0.0]))
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.pi * np.arange(_DIRECTIONS)[:, None, None] / _DIRECTIONS
    slope = np.array(_ELEVATIONS)[None, :, None]
    level = np.cos(angle) * first + np.sin(angle) * second
    directions = np.cos(slope) * level + np.sin(slope) * normal
    sides = np.cross(normal, level)
    ups = np.cross(directions, sides)
    ups = np.where(ups @ normal < 0, -1.0, 1.0)[..., None] * ups
    return directions, np.ascontiguousarray(sides[:, 0]), np.ascontiguousarray(ups)


def dominant_plane(points: Array, sigmas: Array) -> tuple[Array, Array]:
    """Fit a plane robustly to points; return a point of it and its normal towards the camera.

    Args:
        points: (N, 3), N >= 3, m.
        sigmas: (N,), m.
    """
    centre, normal = np.empty(3), np.empty(3)
    _fit_plane(points, sigmas, centre, normal)
    return centre, normal


@compiled
def _fit_plane(points: Array, sigmas: Array, centre: Array, normal: Array) -> None:
    """Fill both, (3,), see ``dominant_plane``."""
    n = points.shape[0]
    heights = np.empty(n)
    spread = np.inf
    for _ in range(_PLANE_ROUNDS):
        total, middle, moments = 0.0, np.zeros(3), np.zeros((3, 3))
        for i in range(n):
            ratio = 0.0 if np.isinf(spread) else heights[i] / (2.0 * spread)
            weight = 1.0 / ((sigmas[i] ** 2 + 0.05**2) * (1.0 + ratio * ratio))
            total += weight
            for a in range(3):
                middle[a] += weight * points[i, a]
                for b in range(3):
                    moments[a, b] += weight * points[i, a] * points[i, b]
        middle /= total
        centre[:] = middle
        for a in range(3):
            for b in range(3):
                moments[a, b] -= total * middle[a] * middle[b]
        _, vectors = np.linalg.eigh(moments)
        normal[:] = vectors[:, 0]
        for i in range(n):
            heights[i] = 0.0
            for a in range(3):
                heights[i] += (points[i, a] - centre[a]) * normal[a]
        spread = max(np.median(np.abs(heights)), 1e-3)
    if np.sum(normal * centre) > 0.0:
        normal[:] = -normal


def vote_for_cylinders(
    surface: SurfacePoints, radius: float, width: int, most: int = 6
) -> list[tuple[Axis, float]]:
    """Find axes of cylinders of known radius on which many surface points lie.

    Points on the face count for a cylinder; points inside it or standing above it count against.

    Args:
        surface: triangulated matches.
        radius: m.
        width: of the left image, px.
        most: hypotheses at most.

    Returns:
        Axes with their votes, the best first.
    """
    if surface.points.shape[0] < 2 * _LEAST_VOTES:
        return []
    surface = _thinned(surface, width)
    _, normal = dominant_plane(surface.points, surface.depth_sigmas)
    tolerance = np.maximum(2.5 * surface.depth_sigmas, _TOLERANCE_SHARE * radius)
    # A depth as uncertain as the radius says nothing of its shape.
    usable = tolerance < 0.7 * radius
    points, tolerance = surface.points[usable], tolerance[usable]
    if points.shape[0] < 2 * _LEAST_VOTES:
        return []
    directions, sides, ups = _directions(normal)
    best = np.empty((*directions.shape[:2], _KEPT_EACH, 3))
    # Coarse: some of the points tell which directions and places are worth all of them.
    step = max(1, min(_COARSE_STEP, len(points) // _COARSE_POINTS))
    few, slack = np.ascontiguousarray(points[::step]), np.ascontiguousarray(tolerance[::step])
    _vote_directions(few, slack, sides, ups, radius, _LEAST_VOTES // step, best)
    azimuths, elevations, ranks = np.nonzero(best[..., 0] > 0.0)
    scores = best[azimuths, elevations, ranks, 0]
    top = np.argsort(-scores, kind="stable")[:_FINE]
    azimuths, elevations = azimuths[top], elevations[top]
    found = best[azimuths, elevations, ranks[top]]
    sides, ups, directions = (
        sides[azimuths],
        ups[azimuths, elevations],
        directions[azimuths, elevations],
    )
    _vote_again(points, tolerance, sides, ups, radius, found)
    order = np.argsort(-found[:, 0], kind="stable")
    order = order[found[order, 0] > 0.0]
    places = found[order, 1:2] * sides[order] + found[order, 2:3] * ups[order]
    return _distinct(places, directions[order], found[order, 0], points, radius, most)


def _thinned(surface: SurfacePoints, width: int) -> SurfacePoints:
    """Return one point of each cell of the left picture."""
    cells = np.floor(surface.left_pixels / (_CELL_SHARE * width)).astype(np.int64)
    _, first = np.unique(cells[:, 0] + 1000 * cells[:, 1], return_index=True)
    chosen = np.zeros(len(cells), np.bool_)
    chosen[first] = True
    return surface.subset(chosen)


def _distinct(
    places: Array, directions: Array, scores: Array, points: Array, radius: float, most: int
) -> list[tuple[Axis, float]]:
    """Keep the best of hypotheses that are nearly the same; put the origin where the points are."""
    middle = np.median(points, axis=0)
    along = np.einsum("ij,ij->i", middle - places, directions)
    centred = places + directions * along[:, None]
    kept = np.empty(most, np.int64)
    chosen = kept[: _choose_distinct(centred, directions, radius, kept)]
    return [(Axis.straight(centred[k], directions[k]), float(scores[k])) for k in chosen]


@compiled
def _choose_distinct(
    places: Array, directions: Array, radius: float, kept: NDArray[np.int64]
) -> int:
    """Fill the first of ``kept`` with lines, the best first, that are not nearly one kept before.

    Args:
        places, directions: of the lines, (K, 3), the best first.
        radius: least gap of lines of like direction, m.
        kept: filled.

    Returns:
        How many are kept.
    """
    count = 0
    for k in range(places.shape[0]):
        if count == kept.shape[0]:
            break
        distinct = True
        for j in kept[:count]:
            off, d = places[k] - places[j], directions[j]
            gap = np.sqrt(np.sum(off * off) - np.sum(off * d) ** 2)
            distinct &= abs(np.sum(d * directions[k])) <= _ALIKE or gap >= radius
        if distinct:
            kept[count] = k
            count += 1
    return count
