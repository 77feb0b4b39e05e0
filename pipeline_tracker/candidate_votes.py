"""Votes for many straight candidates at once (4.1.2, 4.1.3), compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import REFERENCE_WIDTH
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.support import ANGLE, DISTANCE, REACH
from pipeline_tracker.types import Float32Array, VectorizedStereo
from pipeline_tracker.voting import line_support

Array = NDArray[np.float64]

_NEAR = 0.05


@compiled
def _clip(point: Array, direction: Array, camera: Array, low: float, high: float) -> Array:
    """Clip ``point + t * direction``, relative to the camera, to its view; (low, high)."""
    fx, fy, cx, cy, width, height = camera[0], camera[1], camera[2], camera[3], camera[4], camera[5]
    for k in range(5):
        if k == 0:
            value = fx * point[0] + (cx + 0.5) * point[2]
            slope = fx * direction[0] + (cx + 0.5) * direction[2]
        elif k == 1:
            value = -fx * point[0] + (width - 0.5 - cx) * point[2]
            slope = -fx * direction[0] + (width - 0.5 - cx) * direction[2]
        elif k == 2:
            value = fy * point[1] + (cy + 0.5) * point[2]
            slope = fy * direction[1] + (cy + 0.5) * direction[2]
        elif k == 3:
            value = -fy * point[1] + (height - 0.5 - cy) * point[2]
            slope = -fy * direction[1] + (height - 0.5 - cy) * direction[2]
        else:
            value = point[2] - _NEAR
            slope = direction[2]
        if abs(slope) < 1e-12:
            if value < 0.0:
                high = low - 1.0
            continue
        bound = -value / slope
        if slope > 0.0:
            low = max(low, bound)
        else:
            high = min(high, bound)
    return np.array([low, high])


@compiled
def _vote_one(
    axis: Array,
    radius: float,
    camera: Array,
    segments: Float32Array,
    distance: float,
    angle: float,
    reach: float,
    scratch: Array,
) -> float:
    """Sum the contributions to both contours of one straight axis in one image, px."""
    d = axis[3:6] / np.sqrt(axis[3] ** 2 + axis[4] ** 2 + axis[5] ** 2)
    c = axis[:3].copy()
    c[0] -= camera[6]
    t = -(c[0] * d[0] + c[1] * d[1] + c[2] * d[2])
    q = c + t * d
    size = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    if not size > radius:
        return 0.0
    e1 = -q / size
    e2 = np.cross(d, e1)
    near = radius * radius / size
    aside = radius * np.sqrt(size * size - radius * radius) / size
    total = 0.0
    line = np.empty(4)
    for side in (-1.0, 1.0):
        # The section through the axis point that is given, as the range of t counts from there.
        start = c + near * e1 + side * aside * e2
        seen = _clip(start, d, camera, -reach, reach)
        if not seen[0] < seen[1]:
            continue
        for k in range(2):
            end = start + seen[k] * d
            line[2 * k] = camera[0] * end[0] / end[2] + camera[2]
            line[2 * k + 1] = camera[1] * end[1] / end[2] + camera[3]
        part, _ = line_support(segments, line, distance, angle, scratch)
        total += part
    return total


@compiled
def _vote_all(
    axes: Array,
    radius: float,
    camera: Array,
    segments: Float32Array,
    distance: float,
    angle: float,
    factor: float,
    totals: Array,
) -> None:
    """Add each candidate's votes in one image to ``totals``, (K,), px."""
    scratch = np.empty(int(np.sqrt(camera[4] ** 2 + camera[5] ** 2)) + 4)
    for k in range(axes.shape[0]):
        if axes[k, 2] > radius:
            reach = factor * max(1.0, axes[k, 2])
            totals[k] += _vote_one(
                axes[k], radius, camera, segments, distance, angle, reach, scratch
            )


def _numbers(camera: Camera) -> Array:
    return np.array(
        [
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
            camera.offset,
        ]
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
    totals = np.zeros(len(axes))
    if not axes:
        return totals
    table = np.array([np.concatenate((axis.point, axis.direction)) for axis in axes])
    segments = (frame.left_segments, frame.right_segments)
    for number, camera in enumerate(frame.rig.cameras):
        distance = max(DISTANCE * camera.width / REFERENCE_WIDTH, 2.5)
        _vote_all(table, radius, _numbers(camera), segments[number], distance, ANGLE, REACH, totals)
    return totals
