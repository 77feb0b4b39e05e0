"""Votes for many straight candidates at once (4.1.2, 4.1.3), compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import REFERENCE_WIDTH
from pipeline_tracker.geometry.cylinder import boundary_in_view
from pipeline_tracker.jit import compiled
from pipeline_tracker.support import ANGLE, DISTANCE, REACH
from pipeline_tracker.types import Float32Array, VectorizedStereo
from pipeline_tracker.voting import sorted_by_angle, support_of_sorted

Array = NDArray[np.float64]


@compiled
def _add_votes(
    candidates: Array,
    radius: float,
    camera: Array,
    segments: Float32Array,
    angles: Array,
    distance: float,
    totals: Array,
) -> None:
    """Add each candidate's votes in one image to ``totals``, (K,), px."""
    scratch = np.empty(int(np.sqrt(camera[4] ** 2 + camera[5] ** 2)) + 4)
    line = np.empty(4)
    for k in range(candidates.shape[0]):
        point, direction = candidates[k, :3], candidates[k, 3:]
        if not point[2] > radius:
            continue
        reach = REACH * max(1.0, point[2])
        for side in (-1.0, 1.0):
            if boundary_in_view(point, direction, radius, side, camera, -reach, reach, line):
                totals[k] += support_of_sorted(segments, angles, line, distance, ANGLE, scratch)


class Voters:
    """The segments of a vectorized pair, sorted so that they vote for many candidates at once."""

    def __init__(self, frame: VectorizedStereo) -> None:
        """Args: frame, the vectorized pair."""
        segments = (frame.left_segments, frame.right_segments)
        self._views = [
            (camera, *sorted_by_angle(found))
            for camera, found in zip(frame.rig.cameras, segments, strict=False)
        ]

    def votes(self, candidates: Array, radius: float) -> Array:
        """Sum the contributions to all contours of each of many straight candidates.

        Args:
            candidates: (K, 6), a point of each axis, m, and its unit direction, left optical frame.
            radius: m.

        Returns:
            Total contribution of each, (K,), px; 0 for an axis that is not before the camera.
        """
        totals = np.zeros(len(candidates))
        for camera, segments, angles in self._views:
            distance = max(DISTANCE * camera.width / REFERENCE_WIDTH, 2.5)
            _add_votes(candidates, radius, camera.numbers, segments, angles, distance, totals)
        return totals


def vote(frame: VectorizedStereo, axes: list[Axis], radius: float) -> Array:
    """Sum the contributions to all contours of each of many straight candidates.

    Args:
        frame: the vectorized pair.
        axes: K candidates, left optical frame; their bend is not used.
        radius: m.

    Returns:
        Total contribution of each, (K,), px; 0 for an axis that is not before the camera.
    """
    if not axes:
        return np.zeros(0)
    points = np.array([axis.point for axis in axes])
    directions = np.array([axis.direction for axis in axes])
    return Voters(frame).votes(np.hstack((points, directions)), radius)
