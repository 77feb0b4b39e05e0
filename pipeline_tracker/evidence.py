"""What a vectorized pair says about an axis: surface points on its face, segments on its contours.

Left optical frame throughout.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, Evidence
from pipeline_tracker.face import SPAN, face_evidence
from pipeline_tracker.geometry.bent_axis import nearest_to_points, nearest_to_ray, nearest_to_rays
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.surface import SurfacePoints
from pipeline_tracker.types import Float32Array, VectorizedStereo

Array = NDArray[np.float64]

# Patches on the fine grid overlap and err alike: three of them count as two.
_POINT_WEIGHT = 0.65
# How far a rough axis may be from the fit, m, and how far from it segments are looked at, px.
_REACH, _REACH_PIXELS = 0.25, 20.0
# Largest angle of a segment to the contour, rad; its ends may always be so differently far from it,
# px.
ANGLE, _SLACK = 0.12, 1.5
# Standard deviation of a segment's place, px of an image 1200 px wide.
EDGE_SIGMA = 1.5
# The strongest gradient lies outside of the contour: the pipe's limb turns dark before it ends. Px
# at 1200 px width, by rendered seas at 2 and at 4 m.
EDGE_OUTSIDE = 0.7
# Length of contour that counts as one independent sight of it, px at 1200 px width.
EDGE_SAMPLE = 30.0
# However long, a contour counts as at most so many: silt at its foot or the edge of a shadow shifts
# all of it at once.
MOST_SAMPLES = 4.0
REFERENCE_WIDTH = 1200.0


@compiled
def _measure_points(points: Array, axis: Array, normals: Array, distances: Array) -> None:
    """Fill (N, 3) and (N,) as ``distances_from_axis`` returns them."""
    nearest = np.empty((5, points.shape[0]))
    nearest_to_points(axis, np.ascontiguousarray(points.T), nearest)
    for i in range(points.shape[0]):
        distances[i] = nearest[0, i]
        for c in range(3):
            normals[i, c] = nearest[1 + c, i] / max(distances[i], 1e-9)


def rays_to_axis(rays: Array, camera: Camera, axis: Axis) -> Array:
    """Measure rays of one camera against a bent axis.

    Args:
        rays: (N, 3) unit directions.
        camera: the camera that they come from.
        axis: the axis.

    Returns:
        (N, 3): distance between ray and axis, positive where the ray passes to the right of it as
        seen along travel, m; depth along the ray, m; t of the nearest place of the axis, m.
    """
    out = np.empty((3, rays.shape[0]))
    nearest_to_rays(axis.rows, camera.offset, np.ascontiguousarray(rays.T), out)
    return out.T


def distances_from_axis(points: Array, axis: Axis) -> tuple[Array, Array]:
    """Measure points against a bent axis.

    Args:
        points: (N, 3), m.
        axis: the axis.

    Returns:
        Outward unit normals (N, 3) and distances from the axis (N,), m.
    """
    normals, distances = np.empty((points.shape[0], 3)), np.empty(points.shape[0])
    _measure_points(np.ascontiguousarray(points), axis.rows, normals, distances)
    return normals, distances


def unit_rays(pixels: Array, camera: Camera) -> Array:
    """Return unit directions (N, 3) of pixels (N, 2)."""
    rays = camera.rays(pixels)
    unit: Array = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit


def _scale(camera: Camera) -> float:
    return max(1.0, camera.width / REFERENCE_WIDTH)


def nearby(
    frame: VectorizedStereo, surface: SurfacePoints, axis: Axis, radius: float
) -> tuple[VectorizedStereo, SurfacePoints]:
    """Leave out what cannot become evidence for an axis that a fit may reach from a rough one.

    Args:
        frame: the vectorized pair.
        surface: its triangulated matches.
        axis: the rough axis, good to ``_REACH``.
        radius: m.
    """
    segments = []
    for view, found in _views(frame):
        mask = np.empty(len(found), np.bool_)
        reach = _REACH_PIXELS * _scale(view)
        _segments_near(found, view.numbers, axis.rows, radius, reach, mask)
        segments.append(found[mask])
    mask = np.empty(len(surface.rays), np.bool_)
    _rays_near(surface.rays, axis.rows, radius, mask)
    right = segments[1] if len(segments) > 1 else frame.right_segments
    part = replace(frame, left_segments=segments[0], right_segments=right)
    return part, surface.subset(mask)


def _views(frame: VectorizedStereo) -> Iterator[tuple[Camera, Float32Array]]:
    """Yield the one or two cameras with their segments, as compiled functions take them."""
    segments = (frame.left_segments, frame.right_segments)
    for camera, found in zip(frame.rig.cameras, segments, strict=False):
        yield camera, np.ascontiguousarray(found, np.float32)


@compiled
def _unit_ray(
    segments: Float32Array, i: int, end: int, camera: Array
) -> tuple[float, float, float]:
    """Return the unit direction, x y z, of an end (0, 1) of segment i."""
    x = (np.float64(segments[i, 2 * end]) - camera[2]) / camera[0]
    y = (np.float64(segments[i, 2 * end + 1]) - camera[3]) / camera[1]
    scale = 1.0 / np.sqrt(x * x + y * y + 1.0)
    return x * scale, y * scale, scale


@compiled
def _segments_near(
    segments: Float32Array,
    camera: Array,
    axis: Array,
    radius: float,
    reach: float,
    mask: NDArray[np.bool_],
) -> None:
    """Tell which segments lie, with both ends, near a contour of the axis or near what it may be.

    Args:
        segments: (N, 4), px.
        camera: its numbers.
        axis: rows of the axis.
        radius: m.
        reach: px beside what ``_REACH`` covers.
        mask: (N,), filled.
    """
    rays, measured = np.empty((3, segments.shape[0])), np.empty((3, segments.shape[0]))
    mask[:] = True
    for end in range(2):
        for i in range(segments.shape[0]):
            rays[0, i], rays[1, i], rays[2, i] = _unit_ray(segments, i, end, camera)
        nearest_to_rays(axis, camera[6], rays, measured)
        for i in range(segments.shape[0]):
            far = _REACH + reach * abs(measured[1, i]) / camera[0]
            mask[i] &= abs(abs(measured[0, i]) - radius) < far


@compiled
def _rays_near(rays: Array, axis: Array, radius: float, mask: NDArray[np.bool_]) -> None:
    """Tell which rays of the left camera may meet the face of what the axis may become, (N,)."""
    measured = np.empty((3, rays.shape[0]))
    nearest_to_rays(axis, 0.0, np.ascontiguousarray(rays.T), measured)
    for i in range(rays.shape[0]):
        mask[i] = abs(measured[0, i]) < radius + _REACH and abs(measured[2, i]) < SPAN + _REACH


@compiled
def choose_segments(
    segments: Float32Array,
    camera: Array,
    axis: Array,
    radius: float,
    gate: float,
    angle: float,
    span: float,
    chosen: NDArray[np.int64],
    sides: Array,
) -> int:
    """Find the segments along the contours of an axis.

    Args:
        segments, radius, gate, angle, span: see ``contour_rays``.
        camera, axis: numbers and rows.
        chosen, sides: (N,), the first of them filled with numbers of segments and with the side of
            their contour, -1 left and +1 right.

    Returns:
        How many there are.
    """
    scale = max(1.0, camera[4] / REFERENCE_WIDTH)
    rays, measured = np.empty((3, segments.shape[0])), np.empty((3, segments.shape[0]))
    for i in range(segments.shape[0]):
        rays[0, i], rays[1, i], rays[2, i] = _unit_ray(segments, i, 0, camera)
    nearest_to_rays(axis, camera[6], rays, measured)
    count = 0
    for i in range(segments.shape[0]):
        aside, depth, t = measured[0, i], measured[1, i], measured[2, i]
        first = (abs(aside) - radius) * camera[0] / max(depth, 0.05)
        # Most segments are far from the contour with their first end.
        if not (abs(first) < gate and depth > 0.0 and abs(t) < span):
            continue
        rx, ry, rz = _unit_ray(segments, i, 1, camera)
        other, depth, t, _, _, _ = nearest_to_ray(axis, camera[6], rx, ry, rz)
        second = (abs(other) - radius) * camera[0] / max(depth, 0.05)
        if not (abs(second) < gate and depth > 0.0 and abs(t) < span):
            continue
        # The ends of a segment may always differ by a little.
        steepest = max(np.sin(angle) * _length(segments, i), _SLACK * scale)
        if (aside > 0.0) == (other > 0.0) and abs(first - second) < steepest:
            chosen[count] = i
            sides[count] = 1.0 if aside > 0.0 else -1.0
            count += 1
    return count


@compiled
def _length(segments: Float32Array, i: int) -> float:
    dx = np.float64(segments[i, 2]) - segments[i, 0]
    dy = np.float64(segments[i, 3]) - segments[i, 1]
    return float(np.sqrt(dx * dx + dy * dy))


@compiled
def _contour_rays(
    segments: Float32Array,
    camera: Array,
    axis: Array,
    radius: float,
    gate: float,
    angle: float,
    span: float,
    begin: int,
    rays: Array,
    sides: Array,
    weights: Array,
) -> int:
    """Fill rows from ``begin`` on with what ``contour_rays`` finds.

    Args:
        segments, radius, gate, angle, span: see there.
        camera, axis: numbers and rows.
        begin: the first row to fill.
        rays, sides, weights: (.., 3), (..) and (..), with room for both ends of all segments.

    Returns:
        The row after the last that is filled.
    """
    scale = camera[4] / REFERENCE_WIDTH
    chosen, side = np.empty(segments.shape[0], np.int64), np.empty(segments.shape[0])
    count = choose_segments(segments, camera, axis, radius, gate, angle, span, chosen, side)
    sums = np.zeros(2)
    row = begin
    for k in range(count):
        i = chosen[k]
        weight = _length(segments, i) / (2.0 * EDGE_SAMPLE * scale)
        sums[int(side[k] > 0.0)] += 2.0 * weight
        for end in range(2):
            rays[row, 0], rays[row, 1], rays[row, 2] = _unit_ray(segments, i, end, camera)
            sides[row] = side[k]
            weights[row] = weight
            row += 1
    for k in range(begin, row):
        weights[k] *= min(1.0, MOST_SAMPLES / max(sums[int(sides[k] > 0.0)], 1e-9))
    return row


def contour_rays(
    segments: Float32Array,
    camera: Camera,
    axis: Axis,
    radius: float,
    gate: float,
    angle: float = ANGLE,
    span: float = SPAN,
) -> tuple[Array, Array, Array]:
    """Find the segments that lie along the predicted contours of an axis.

    Args:
        segments: (N, 4) float32, px.
        camera: the camera they were seen by.
        axis: the predicted axis.
        radius: m.
        gate: largest distance of either end from the contour, px.
        angle: largest angle to the contour, rad.
        span: of the axis to each side of its origin that is looked at, m.

    Returns:
        Unit rays of both ends of each such segment (2 K, 3), the side of its contour (2 K,),
        -1 left and +1 right, and weights (2 K,).
    """
    ends = 2 * segments.shape[0]
    rays, sides, weights = np.empty((ends, 3)), np.empty(ends), np.empty(ends)
    count = _contour_rays(
        np.ascontiguousarray(segments, np.float32),
        camera.numbers,
        axis.rows,
        radius,
        gate,
        angle,
        span,
        0,
        rays,
        sides,
        weights,
    )
    return rays[:count], sides[:count], weights[:count]


def gather(
    frame: VectorizedStereo,
    surface: SurfacePoints,
    axis: Axis,
    radius: float,
    gate: float,
    *,
    surface_only: bool = False,
) -> Evidence:
    """Gather what speaks of an axis near a prediction: points on its face, contours near its own.

    Args:
        frame: the vectorized pair.
        surface: its triangulated matches.
        axis: the predicted axis.
        radius: m.
        gate: largest distance of a segment from the predicted contour, px at 1200 px width.
        surface_only: no contours where there are points.
    """
    points, point_sigmas = face_evidence(surface, frame.rig.left, axis, radius)
    views = [] if surface_only and len(points) else list(_views(frame))
    ends = 2 * sum(len(found) for _, found in views)
    rays, sides, weights = np.empty((ends, 3)), np.empty(ends), np.empty(ends)
    origins, sigmas = np.zeros((ends, 3)), np.empty(ends)
    begin = 0
    for view, found in views:
        scale = view.width / REFERENCE_WIDTH
        end = _contour_rays(
            found,
            view.numbers,
            axis.rows,
            radius,
            max(gate * scale, 2.0),
            ANGLE,
            SPAN,
            begin,
            rays,
            sides,
            weights,
        )
        origins[begin:end, 0] = view.offset
        sigmas[begin:end] = max(EDGE_SIGMA * scale, 0.6) / view.fx
        begin = end
    return Evidence(
        points=points,
        point_sigmas=point_sigmas,
        rays=rays[:begin],
        origins=origins[:begin],
        sides=sides[:begin],
        ray_sigmas=sigmas[:begin],
        ray_weights=weights[:begin],
        point_weight=_POINT_WEIGHT,
    )
