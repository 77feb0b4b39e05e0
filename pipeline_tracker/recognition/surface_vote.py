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

_DIRECTIONS = 60
_ELEVATIONS = (-0.2, 0.0, 0.2)
# Only what rises this far to each side of the axis is taken for the face, as a share of r.
_STRIP_SHARE = 0.85
_LEAST_VOTES = 8


@compiled
def _vote_directions(
    u: Array, h: Array, tolerance: Array, radius: float, step: float, best: Array
) -> None:
    """Vote for axis positions of one direction in the plane across it.

    Args:
        u, h: place across and height of each point, sorted by ``u``, (N,), m.
        tolerance: of each point's height, (N,), m.
        radius: m.
        step: m between the positions tried.
        best: (K, 3) filled with score, position across, height of the axis; score descending.
    """
    n = u.shape[0]
    keep = best.shape[0]
    heights = np.empty(n)
    slack = np.empty(n)
    first = 0
    position = u[0]
    while position <= u[n - 1]:
        while first < n and u[first] < position - _STRIP_SHARE * radius:
            first += 1
        count = 0
        i = first
        while i < n and u[i] <= position + _STRIP_SHARE * radius:
            off = u[i] - position
            # The height at which the axis would lie, were this point on the pipe's upper face.
            heights[count] = h[i] - np.sqrt(radius * radius - off * off)
            slack[count] = tolerance[i]
            count += 1
            i += 1
        if count >= _LEAST_VOTES:
            for a in range(count):
                level = heights[a]
                votes = 0.0
                for b in range(count):
                    gap = heights[b] - level
                    if abs(gap) <= slack[b]:
                        votes += 1.0 - 0.5 * abs(gap) / slack[b]
                    elif gap < 0.0:
                        # It lies inside the cylinder: the camera would look through the pipe.
                        votes -= 0.7
                    else:
                        votes -= 0.4
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
    surface: SurfacePoints, radius: float, most: int = 6
) -> list[tuple[Axis, float]]:
    """Find axes of cylinders of known radius on which many surface points lie.

    Points on the face count for a cylinder; points inside it or standing above it count against.

    Args:
        surface: triangulated matches.
        radius: m.
        most: hypotheses at most.

    Returns:
        Axes with their votes, the best first.
    """
    if surface.points.shape[0] < 2 * _LEAST_VOTES:
        return []
    _, normal = dominant_plane(surface.points, surface.depth_sigmas)
    tolerance = np.maximum(2.5 * surface.depth_sigmas, 0.06 * radius)
    # A depth as uncertain as the radius says nothing of its shape.
    usable = tolerance < 0.7 * radius
    points, tolerance = surface.points[usable], tolerance[usable]
    if points.shape[0] < 2 * _LEAST_VOTES:
        return []
    first = np.cross(normal, np.array([1.0, 0.0, 0.0]))
    if np.linalg.norm(first) < 0.1:
        first = np.cross(normal, np.array([0.0, 1.0, 0.0]))
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    found: list[tuple[float, Array, Array]] = []
    for k in range(_DIRECTIONS):
        angle = np.pi * k / _DIRECTIONS
        level = np.cos(angle) * first + np.sin(angle) * second
        for elevation in _ELEVATIONS:
            direction = np.cos(elevation) * level + np.sin(elevation) * normal
            side = np.cross(normal, level)
            height = np.cross(direction, side)
            if float(height @ normal) < 0:
                height = -height
            u, h = points @ side, points @ height
            order = np.argsort(u, kind="stable")
            best = np.zeros((3, 3))
            _vote_directions(u[order], h[order], tolerance[order], radius, radius / 6.0, best)
            for score, position, lift in best:
                if score > 0:
                    found.append((float(score), position * side + lift * height, direction))
    found.sort(key=lambda entry: -entry[0])
    return _distinct(found, points, radius, most)


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
