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
from pipeline_tracker.voting import middles_of, support_by_middles

Array = NDArray[np.float64]

# Least distance R, px, however small the picture.
_LEAST_DISTANCE = 2.5


@compiled
def add_votes(
    candidates: Array,
    radius: float,
    camera: Array,
    segments: Float32Array,
    middles: Array,
    totals: Array,
) -> None:
    """Add each candidate's votes in one image to ``totals``.

    Args:
        candidates: (K, 6), a point of each axis, m, and its unit direction, left optical frame.
        radius: m.
        camera: its numbers.
        segments, middles: of its image, (N, 4) and (2, N), px.
        totals: (K,), px, changed; nothing is added for an axis that is not before the camera.
    """
    distance = max(DISTANCE * camera[4] / REFERENCE_WIDTH, _LEAST_DISTANCE)
    scratch = np.empty(int(np.sqrt(camera[4] ** 2 + camera[5] ** 2)) + 4)
    off = np.empty(segments.shape[0])
    line = np.empty(4)
    for k in range(candidates.shape[0]):
        point, direction = candidates[k, :3], candidates[k, 3:]
        if not point[2] > radius:
            continue
        reach = REACH * max(1.0, point[2])
        for side in (-1.0, 1.0):
            if boundary_in_view(point, direction, radius, side, camera, -reach, reach, line):
                totals[k] += support_by_middles(
                    segments, middles, line, distance, ANGLE, scratch, off
                )


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
    candidates, totals = np.hstack((points, directions)), np.zeros(len(axes))
    views = (frame.left_segments, frame.right_segments)
    for camera, found in zip(frame.rig.cameras, views, strict=False):
        segments = np.ascontiguousarray(found, np.float32)
        add_votes(candidates, radius, camera.numbers, segments, middles_of(segments), totals)
    return totals
