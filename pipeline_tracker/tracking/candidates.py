"""Candidates for the axis: rays from the end of the previous piece, ranked by voting (4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, across
from pipeline_tracker.candidate_votes import Voters
from pipeline_tracker.evidence import contour_rays
from pipeline_tracker.types import VectorizedStereo

Array = NDArray[np.float64]

# Half width and step of the grid of each round, rad: 8 degrees in steps of 2, then finer about the
# winner. The same angles for heading and pitch.
_ROUNDS = ((0.14, 0.035), (0.0263, 0.00877), (0.0066, 0.0022))


def _grid(half: float, step: float) -> Array:
    """Return tangents of heading and pitch of all candidates of a round, (K, 2)."""
    steps = np.tan(np.arange(-half, half + 0.5 * step, step))
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)


_GRIDS = [_grid(half, step) for half, step in _ROUNDS]
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
    voters = Voters(_nearby(frame, Axis.straight(start, direction), radius))
    best = direction / np.linalg.norm(direction)
    most = float(voters.votes(np.concatenate((start, best))[None], radius)[0])
    for grid in _GRIDS:
        left, up = across(best, vertical)
        candidates = np.empty((len(grid), 6))
        candidates[:, :3] = start
        candidates[:, 3:] = best + grid[:, :1] * left + grid[:, 1:] * up
        candidates[:, 3:] /= np.linalg.norm(candidates[:, 3:], axis=1)[:, None]
        votes = voters.votes(candidates, radius)
        winner = int(np.argmax(votes))
        if votes[winner] > most:
            best, most = candidates[winner, 3:].copy(), float(votes[winner])
    return Axis.straight(start, best), most


def _nearby(frame: VectorizedStereo, axis: Axis, radius: float) -> VectorizedStereo:
    """The frame with only those segments that some candidate's contour may pass."""
    kept = []
    segments = (frame.left_segments, frame.right_segments)
    for number, camera in enumerate(frame.rig.cameras):
        found = segments[number]
        gate = _GATE * camera.width / 1200.0
        rays, _, _ = contour_rays(found, camera, axis, radius, gate, _STEEPEST, np.inf)
        pixels = rays[:, :2] / rays[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        kept.append(pixels.astype(np.float32).reshape(-1, 4))
    empty = np.zeros((0, 4), np.float32)
    return VectorizedStereo(
        stamp_ns=frame.stamp_ns,
        rig=frame.rig,
        left_segments=kept[0],
        right_segments=kept[1] if len(kept) > 1 else empty,
        matches=empty,
        left_thumbnail=frame.left_thumbnail,
        right_thumbnail=frame.right_thumbnail,
    )
