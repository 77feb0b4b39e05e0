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


@compiled
def _best_level(
    heights: Array, slack: Array, count: int, width: float, table: Array
) -> tuple[float, float]:
    """Find the height of the axis for which most points of one strip vote.

    Args:
        heights: for each point the height at which the axis would lie, were the point on the
            pipe's upper face, m.
        slack: tolerance of each, m.
        count: how many of both are in use.
        width: of a cell of the table, m.
        table: (3, cells), room for votes, points above and points below.

    Returns:
        Votes less objections, and the height, m.
    """
    cells = table.shape[1]
    # A sample is enough to know where about the strip lies.
    low = np.median(heights[: count : 1 + count // 16]) - 0.5 * cells * width
    table[:] = 0.0
    for k in range(count):
        place = (heights[k] - low) / width
        reach = slack[k] / width
        first = max(0, int(np.ceil(place - reach)))
        last = min(cells - 1, int(np.floor(place + reach)))
        for cell in range(first, last + 1):
            table[0, cell] += 1.0 - 0.5 * abs(cell - place) / reach
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
def _vote_across(
    u: Array, h: Array, tolerance: Array, radius: float, step: float, best: Array, room: Array
) -> None:
    """Vote for axis positions of one direction in the plane across it.

    Args:
        u, h: place across and height of each point, sorted by ``u``, (N,), m.
        tolerance: of each point's height, (N,), m.
        radius: m.
        step: m between the positions tried.
        best: (K, 3) filled with score, position across, height of the axis; score descending.
        room: (2, N), overwritten.
    """
    n = u.shape[0]
    keep = best.shape[0]
    heights, slack = room[0], room[1]
    width = max(0.4 * np.median(tolerance), 0.01 * radius)
    table = np.empty((3, max(8, int(4.0 * radius / width))))
    first = 0
    position = u[0]
    while position <= u[n - 1]:
        while first < n and u[first] < position - _STRIP_SHARE * radius:
            first += 1
        count = 0
        i = first
        while i < n and u[i] <= position + _STRIP_SHARE * radius:
            off = u[i] - position
            heights[count] = h[i] - np.sqrt(radius * radius - off * off)
            slack[count] = tolerance[i]
            count += 1
            i += 1
        # A strip has no more votes than points.
        if count >= _LEAST_VOTES and count > best[keep - 1, 0]:
            votes, level = _best_level(heights, slack, count, width, table)
            if votes > best[keep - 1, 0]:
                place = keep - 1
                # A better vote near an earlier one takes its place.
                for k in range(keep):
                    if best[k, 0] > 0.0 and abs(best[k, 1] - position) < 0.5 * radius:
                        place = k
                        break
                if votes > best[place, 0]:
                    best[place, 0] = votes
                    best[place, 1] = position
                    best[place, 2] = level
                    while place > 0 and best[place, 0] > best[place - 1, 0]:
                        for c in range(3):
                            held = best[place, c]
                            best[place, c] = best[place - 1, c]
                            best[place - 1, c] = held
                        place -= 1
        position += step


@compiled
def _vote_directions(
    points: Array, tolerance: Array, sides: Array, heights: Array, radius: float, out: Array
) -> None:
    """Vote for each direction.

    Args:
        points: (N, 3), m.
        tolerance: (N,), m.
        sides, heights: unit vectors across each direction, level and up, (D, 3).
        radius: m.
        out: (D, K, 3) filled, see ``_vote_across``.
    """
    n = points.shape[0]
    u, h = np.empty(n), np.empty(n)
    sorted_u, sorted_h, sorted_tolerance = np.empty(n), np.empty(n), np.empty(n)
    room = np.empty((2, n))
    out[:] = 0.0
    for d in range(sides.shape[0]):
        for i in range(n):
            u[i] = 0.0
            h[i] = 0.0
            for k in range(3):
                u[i] += points[i, k] * sides[d, k]
                h[i] += points[i, k] * heights[d, k]
        order = np.argsort(u, kind="mergesort")
        for i in range(n):
            sorted_u[i] = u[order[i]]
            sorted_h[i] = h[order[i]]
            sorted_tolerance[i] = tolerance[order[i]]
        step = _STEP_SHARE * radius
        _vote_across(sorted_u, sorted_h, sorted_tolerance, radius, step, out[d], room)


def _directions(normal: Array) -> tuple[Array, Array, Array]:
    """Return directions (D, 3) around a plane's normal, and the vectors across: level and up."""
    first = np.cross(normal, np.array([1.0, 0.0, 0.0]))
    if np.linalg.norm(first) < 0.1:
        first = np.cross(normal, np.array([0.0, 1.0, 0.0]))
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.pi * np.arange(_DIRECTIONS)[:, None, None] / _DIRECTIONS
    slope = np.array(_ELEVATIONS)[None, :, None]
    level = np.cos(angle) * first + np.sin(angle) * second
    directions = np.cos(slope) * level + np.sin(slope) * normal
    sides = np.broadcast_to(np.cross(normal, level), directions.shape)
    heights = np.cross(directions, sides)
    heights = np.where(heights @ normal < 0, -1.0, 1.0)[..., None] * heights
    flat = [np.ascontiguousarray(part.reshape(-1, 3)) for part in (directions, sides, heights)]
    return flat[0], flat[1], flat[2]


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
    directions, sides, heights = _directions(normal)
    best = np.empty((len(directions), _KEPT_EACH, 3))
    _vote_directions(points, tolerance, sides, heights, radius, best)
    found = [
        (float(score), position * sides[d] + lift * heights[d], directions[d])
        for d, k in zip(*np.nonzero(best[:, :, 0] > 0.0), strict=True)
        for score, position, lift in [best[d, k]]
    ]
    found.sort(key=lambda entry: -entry[0])
    return _distinct(found, points, radius, most)


def _thinned(surface: SurfacePoints, width: int) -> SurfacePoints:
    """Return one point of each cell of the left picture."""
    cells = np.floor(surface.left_pixels / (_CELL_SHARE * width)).astype(np.int64)
    _, first = np.unique(cells[:, 0] + 1000 * cells[:, 1], return_index=True)
    chosen = np.zeros(len(cells), np.bool_)
    chosen[first] = True
    return surface.subset(chosen)


def _distinct(
    found: list[tuple[float, Array, Array]], points: Array, radius: float, most: int
) -> list[tuple[Axis, float]]:
    """Keep the best of hypotheses that are nearly the same; put the origin where the points are."""
    kept: list[tuple[Axis, float]] = []
    middle = np.median(points, axis=0)
    for score, point, direction in found:
        centred = point + direction * float((middle - point) @ direction)
        same = any(
            abs(float(axis.direction @ direction)) > 0.97
            and float(np.linalg.norm(np.cross(centred - axis.point, axis.direction))) < radius
            for axis, _ in kept
        )
        if not same:
            kept.append((Axis.straight(centred, direction), score))
        if len(kept) == most:
            break
    return kept
