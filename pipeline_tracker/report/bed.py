"""The bed beside the pipe: a hint at free spans and burial."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import PipeSegment, VectorizedStereo

Array = NDArray[np.float64]

# The strips of bed that are looked at: from and to, in radii beside the axis, and m along it.
# Nearer lie points of the pipe's own flank.
_NEAR, _FAR = 1.2, 2.2
_HALF_LENGTH = 0.75
_LEAST_POINTS = 10


def bed_beside(
    vectorized: VectorizedStereo, segment: PipeSegment, mounting: Pose, pose: Pose | None
) -> tuple[float | None, float | None]:
    """Measure how high the pipe's axis is above the bed on both sides of it.

    Each is the median over the matched points of a strip of bed close to the pipe. A pipe that
    rests on a flat bed has its radius on both sides; below a free span, and where the current has
    carried the bed away, it is more, where the pipe is buried less.

    Args:
        vectorized: matches and cameras.
        segment: the pipe, in base_link.
        mounting: base_link <- left optical frame.
        pose: odom <- base_link; None: base_link is taken as level.

    Returns:
        Height above the bed to the left and to the right along start -> end, m; None for a side
        where too few points were matched, in mono, and for a vertical pipe.
    """
    along = segment.end - segment.start
    length = float(np.linalg.norm(along))
    up = np.array([0.0, 0.0, 1.0]) if pose is None else pose.rotation[2]
    left = np.cross(up, along)
    across = float(np.linalg.norm(left))
    if not (segment.found and across > 0.1 * length > 0.0):
        return None, None
    away = mounting.apply(_points(vectorized)) - (segment.start + segment.end) / 2.0
    way = away @ along / length
    # Above the axis, which may slope.
    height = away @ up - way * float(along @ up) / length
    beside = away @ left / across / segment.radius
    near = np.abs(way) < _HALF_LENGTH
    return (
        _median_depth(height[near & (beside > _NEAR) & (beside < _FAR)]),
        _median_depth(height[near & (beside < -_NEAR) & (beside > -_FAR)]),
    )


def _points(vectorized: VectorizedStereo) -> Array:
    """Return the matched points, (N, 3) m, in the left optical frame."""
    rig, matches = vectorized.rig, vectorized.matches.astype(np.float64)
    if rig.right is None:
        return np.zeros((0, 3))
    rays = rig.left.rays(matches[:, :2])
    parallax = rays[:, 0] - rig.right.rays(matches[:, 2:])[:, 0]
    # Nothing that is further away than a thousand baselines lies beside a pipe.
    seen = parallax > 1e-3
    return np.asarray(rays[seen] * (rig.baseline / parallax[seen])[:, None])


def _median_depth(heights: Array) -> float | None:
    return -float(np.median(heights)) if len(heights) >= _LEAST_POINTS else None
