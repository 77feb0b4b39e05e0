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
# Between two of the directions tried, the pipe's surface is off by some centimetres at the ends of
# the view: a point counts that is no further off than this share of r, be it ever so exact.
_TOLERANCE_SHARE = 0.15
# Only what rises this far to each side of the axis is taken for the face, as a share of r.
_STRIP_SHARE = 0.85
_LEAST_VOTES = 8
# One point is taken of each cell of the picture, this share of its width: where matches are dense
# they would outvote the bed, and a start needs no more.
_CELL_SHARE = 1.0 / 36.0
# Step between the positions tried across, as a share of r.
_STEP_SHARE = 0.25
_KEPT_EACH = 3
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
    heights: Array, slack: Array, count: int, width: float, table: Array, room: Array
) -> tuple[float, float]:
    """Find the height of the axis for which most points of one strip vote.

    Args:
        heights: for each point the height at which the axis would lie, were the point on the
            pipe's upper face, m.
        slack: tolerance of each, m.
        count: how many of both are in use.
        width: of a cell of the table, m.
        table: (3, cells), room for votes, points above and points below.
        room: (32,), overwritten.

    Returns:
        Votes less objections, and the height, m.
    """
    cells = table.shape[1]
    # A sample is enough to know where about the strip lies.
    low = _middle(heights, count, room) - 0.5 * cells * width
    table[:] = 0.0
    for k in range(count):
        place = (heights[k] - low) / width
        reach = slack[k] / width
        first = max(0, int(np.ceil(place - reach)))
        last = min(cells - 1, int(np.floor(place + reach)))
        fall = 0.5 / reach
        for cell in range(first, last + 1):
            table[0, cell] += 1.0 - fall * abs(cell - place)
        # Of the cells before the first this point stands above the pipe; for those after the
        # last it lies inside it, and the camera would look through the pipe.
        if first > 0:
            table[1, min(first, cells) - 1] += 1.0
        if last < cells - 1:
            table[2, max(last, -1) + 1] += 1.0
    above = 0.0
    for cell in range(cells - 1, -1, -1):
        above += table[1, cell]
        table[0, cell] -= 0.4 * above
    inside = 0.0
    best = 0
    for cell in range(cells):
        inside += table[2, cell]
        table[0, cell] -= 0.7 * inside
        if table[0, cell] > table[0, best]:
            best = cell
    return table[0, best], low + best * width


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
    tolerance: Array,
    radius: float,
    least: int,
    table: Array,
    width: float,
    best: Array,
) -> None:
    """Vote for axis positions in the plane across, for directions that differ in elevation only.

    Args:
        u: place across of each point, ascending, (N,), m.
        h: height of each point for each elevation, (E, N), m.
        tolerance: of each point's height, (N,), m.
        radius: m.
        least: points that a strip must have.
        table, width: see ``_best_level``.
        best: (E, K, 3) filled with score, position across, height of the axis; score descending.
    """
    n = u.shape[0]
    last = best.shape[1] - 1
    heights, lift, room = np.empty(n), np.empty(n), np.empty(32)
    begin = 0
    position = u[0]
    while position <= u[n - 1]:
        while begin < n and u[begin] < position - _STRIP_SHARE * radius:
            begin += 1
        end = begin
        while end < n and u[end] <= position + _STRIP_SHARE * radius:
            off = u[end] - position
            lift[end] = np.sqrt(radius * radius - off * off)
            end += 1
        count = end - begin
        for e in range(h.shape[0]):
            # A strip has no more votes than points.
            if count < least or not count > best[e, last, 0]:
                continue
            for i in range(begin, end):
                heights[i - begin] = h[e, i] - lift[i]
            slack = tolerance[begin:end]
            votes, level = _best_level(heights, slack, count, width, table, room)
            if votes > best[e, last, 0]:
                _keep(best[e], votes, position, level, 0.5 * radius)
        position += _STEP_SHARE * radius


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
    table = np.empty((3, max(8, int(4.0 * radius / width))))
    h, slack = np.empty((ups.shape[1], n)), np.empty(n)
    out[:] = 0.0
    for a in range(sides.shape[0]):
        u = points @ sides[a]
        # Directions of one azimuth have the same places across: they are sorted once.
        order = np.argsort(u, kind="mergesort")
        for k in range(n):
            i = order[k]
            slack[k] = tolerance[i]
            for e in range(ups.shape[1]):
                h[e, k] = (
                    points[i, 0] * ups[a, e, 0]
                    + points[i, 1] * ups[a, e, 1]
                    + points[i, 2] * ups[a, e, 2]
                )
        _vote_across(u[order], h, slack, radius, least, table, width, out[a])


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
    heights, slack, room = np.empty(n), np.empty(n), np.empty(32)
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
                    slack[count] = tolerance[i]
                    count += 1
            if count < _LEAST_VOTES:
                continue
            votes, level = _best_level(heights, slack, count, width, table, room)
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
    weights = 1.0 / np.square(np.hypot(sigmas, 0.05))
    base = weights.copy()
    centre, normal = points.mean(axis=0), np.array([0.0, 0.0, -1.0])
    for _ in range(5):
        centre = (points * weights[:, None]).sum(axis=0) / weights.sum()
        away = points - centre
        _, vectors = np.linalg.eigh((away * weights[:, None]).T @ away)
        normal = vectors[:, 0]
        height = away @ normal
        spread = max(float(np.median(np.abs(height))), 1e-3)
        weights = base / (1.0 + np.square(height / (2.0 * spread)))
    if float(normal @ centre) > 0:
        normal = -normal
    return centre, normal


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
    kept: list[tuple[Axis, float]] = []
    middle = np.median(points, axis=0)
    along = np.einsum("ij,ij->i", middle - places, directions)
    centred = places + directions * along[:, None]
    open_ = np.ones(len(places), np.bool_)
    for k in range(len(places)):
        if not open_[k]:
            continue
        kept.append((Axis.straight(centred[k], directions[k]), float(scores[k])))
        if len(kept) == most:
            break
        gaps = np.linalg.norm(np.cross(centred - centred[k], directions[k]), axis=1)
        open_ &= (np.abs(directions @ directions[k]) <= 0.97) | (gaps >= radius)
    return kept
