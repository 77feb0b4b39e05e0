"""Candidates for the axis: rays from the end of the previous piece, ranked by voting (4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.axis_solver import fill_across
from pipeline_tracker.candidate_votes import add_votes
from pipeline_tracker.evidence import REFERENCE_WIDTH, choose_segments
from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array, VectorizedStereo

Array = NDArray[np.float64]

# Half width and step of the grid of each round, rad: 8 degrees in steps of 2, then finer about the
# winner. The same angles for heading and pitch.
_ROUNDS = ((0.14, 0.035), (0.0175, 0.00875), (0.0044, 0.0022))


# Segments further from the predicted contour, px at 1200 px width, or steeper to it, can vote for
# no candidate; leaving them out changes no vote.
_GATE, _STEEPEST = 160.0, 0.4


def best_candidate(
    frame: VectorizedStereo, start: Array, direction: Array, radius: float, vertical: Array
) -> tuple[Axis, float]:
    """Find the ray from a fixed point whose four visible boundaries win the vote (4.1, 4.1.3).

    Args:
        frame: the vectorized pair.
        start: C, the end of the previous piece of the axis, left optical frame, (3,), m.
        direction: previous direction, unit, (3,).
        radius: m.
        vertical: unit vector up, left optical frame.

    Returns:
        The straight axis through C and its total contribution, px.
    """
    left, right, seen_right = frame.rig.left, frame.rig.right, frame.right_segments
    if right is None:
        right, seen_right = left, frame.right_segments[:0]
    found = np.empty(3)
    most = _search(
        start,
        direction,
        radius,
        vertical,
        left.numbers,
        np.ascontiguousarray(frame.left_segments, np.float32),
        right.numbers,
        np.ascontiguousarray(seen_right, np.float32),
        found,
    )
    return Axis.straight(start, found), most


@compiled
def _search(
    start: Array,
    direction: Array,
    radius: float,
    vertical: Array,
    left_camera: Array,
    left_segments: Float32Array,
    right_camera: Array,
    right_segments: Float32Array,
    best: Array,
) -> float:
    """Try one grid of directions after the other, see ``best_candidate``.

    Args:
        start, direction, radius, vertical: see there.
        left_camera, right_camera: numbers.
        left_segments, right_segments: (N, 4), px.
        best: (3,), filled with the winner's unit direction.

    Returns:
        The winner's votes, px.
    """
    best[:] = direction / np.sqrt(np.sum(direction * direction))
    axis = np.zeros((3, 3))
    axis[0], axis[1] = start, best
    left_segments, left_middles = _nearby(left_segments, left_camera, axis, radius)
    right_segments, right_middles = _nearby(right_segments, right_camera, axis, radius)
    across_it = np.empty((2, 3))
    most = -1.0
    for half, step in _ROUNDS:
        fill_across(best, vertical, across_it[0], across_it[1])
        side = int(half / step + 0.5)
        candidates = np.empty(((2 * side + 1) ** 2 + 1, 6))
        candidates[:, :3] = start
        # First the one that is to be beaten.
        candidates[0, 3:] = best
        k = 1
        for i in range(-side, side + 1):
            for j in range(-side, side + 1):
                length = 0.0
                for c in range(3):
                    turned = best[c] + np.tan(i * step) * across_it[0, c]
                    candidates[k, 3 + c] = turned + np.tan(j * step) * across_it[1, c]
                    length += candidates[k, 3 + c] ** 2
                candidates[k, 3:] /= np.sqrt(length)
                k += 1
        votes = np.zeros(candidates.shape[0])
        add_votes(candidates, radius, left_camera, left_segments, left_middles, votes)
        add_votes(candidates, radius, right_camera, right_segments, right_middles, votes)
        winner = np.argmax(votes)
        most = votes[winner]
        best[:] = candidates[winner, 3:]
    return most


@compiled
def _nearby(
    segments: Float32Array, camera: Array, axis: Array, radius: float
) -> tuple[Float32Array, Array]:
    """Return only those segments that some candidate's contour may pass, and their middles."""
    chosen, sides = np.empty(segments.shape[0], np.int64), np.empty(segments.shape[0])
    gate = _GATE * camera[4] / REFERENCE_WIDTH
    count = choose_segments(segments, camera, axis, radius, gate, _STEEPEST, np.inf, chosen, sides)
    near, middles = np.empty((count, 4), np.float32), np.empty((2, count))
    for k in range(count):
        i = chosen[k]
        near[k] = segments[i]
        middles[0, k] = 0.5 * (np.float64(segments[i, 0]) + segments[i, 2])
        middles[1, k] = 0.5 * (np.float64(segments[i, 1]) + segments[i, 3])
    return near, middles
