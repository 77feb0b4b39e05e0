"""What a vectorized pair says about an axis: surface points on its face, segments on its contours.

Left optical frame throughout. "Face" is the part of the pipe's surface that the left camera sees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, Evidence
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.surface import SurfacePoints
from pipeline_tracker.types import Float32Array, VectorizedStereo
from pipeline_tracker.vectorization.patch_alignment import patch_variance
from pipeline_tracker.vectorization.working_size import working_factor

Array = NDArray[np.float64]

# Roughness of what is matched (growth, coating), m: no point is known better than this.
ROUGHNESS = 0.003
# The face is taken up to this share of the radius to each side; nearer to the contour a patch
# holds pipe and bed at once.
FACE_SHARE = 0.9
# A patch that reaches over the contour holds bed too: so far from it, px at the working size.
_BORDER = 10.0
# Mean square of a patch's reach, px² at the working size, and the least squared cosine of the angle
# at which the pipe's round is looked at (near the contour it is not a parabola).
_PATCH_VARIANCE = patch_variance()
_LEAST_FACING = 0.1
# Patches on the fine grid overlap and err alike: three of them count as two.
_POINT_WEIGHT = 0.65
# Only so much of the axis to each side of the middle is fitted, m: one bend describes no more of a
# real pipe than that.
SPAN = 1.75
# Sections by which a covered stretch is told, m, their least points, and how far off a point still
# lies on the pipe, in standard deviations.
_SECTION, _SECTION_POINTS, _ON_FACE = 0.2, 8, 3.0
# How far a rough axis may be from the fit, m, and how far from it segments are looked at, px.
_REACH, _REACH_PIXELS = 0.25, 20.0
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
def _ray_to_axis(
    rays: Array, origin: Array, point: Array, direction: Array, bend: Array, out: Array
) -> None:
    """Fill, for unit rays from ``origin``: signed distance from the axis, depth, t of the axis.

    The distance is positive where the ray passes to the right of the axis, as seen along travel.
    """
    x = np.empty(3)
    d = np.empty(3)
    for i in range(rays.shape[0]):
        t = 0.0
        depth = 0.0
        for _ in range(3):
            norm = 0.0
            for k in range(3):
                x[k] = point[k] + t * direction[k] + 0.5 * t * t * bend[k]
                d[k] = direction[k] + t * bend[k]
                norm += d[k] * d[k]
            norm = np.sqrt(norm)
            rd = 0.0
            rw = 0.0
            dw = 0.0
            for k in range(3):
                d[k] /= norm
                w = x[k] - origin[k]
                rd += rays[i, k] * d[k]
                rw += rays[i, k] * w
                dw += d[k] * w
            slope = max(1e-9, 1.0 - rd * rd)
            depth = (rw - rd * dw) / slope
            t += (rd * rw - dw) / slope
        for k in range(3):
            x[k] = point[k] + t * direction[k] + 0.5 * t * t * bend[k]
        mx = rays[i, 1] * d[2] - rays[i, 2] * d[1]
        my = rays[i, 2] * d[0] - rays[i, 0] * d[2]
        mz = rays[i, 0] * d[1] - rays[i, 1] * d[0]
        norm = max(1e-9, np.sqrt(mx * mx + my * my + mz * mz))
        aside = ((x[0] - origin[0]) * mx + (x[1] - origin[1]) * my + (x[2] - origin[2]) * mz) / norm
        out[i, 0] = -aside
        out[i, 1] = depth
        out[i, 2] = t


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
    out = np.empty((rays.shape[0], 3))
    if rays.shape[0]:
        _ray_to_axis(
            np.ascontiguousarray(rays), camera.centre, axis.point, axis.direction, axis.bend, out
        )
    return out


def distances_from_axis(points: Array, axis: Axis) -> tuple[Array, Array]:
    """Measure points against a bent axis.

    Args:
        points: (N, 3), m.
        axis: the axis.

    Returns:
        Outward unit normals (N, 3) and distances from the axis (N,), m.
    """
    t = (points - axis.point) @ axis.direction
    for _ in range(2):
        near = axis.point + t[:, None] * axis.direction + 0.5 * (t * t)[:, None] * axis.bend
        tangent = axis.direction + t[:, None] * axis.bend
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        t = t + np.einsum("ij,ij->i", points - near, tangent)
    near = axis.point + t[:, None] * axis.direction + 0.5 * (t * t)[:, None] * axis.bend
    away = points - near
    distance = np.linalg.norm(away, axis=1)
    return away / np.maximum(distance, 1e-9)[:, None], distance


def unit_rays(pixels: Array, camera: Camera) -> Array:
    """Return unit directions (N, 3) of pixels (N, 2)."""
    rays = camera.rays(pixels)
    unit: Array = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit


def on_face(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float, share: float = FACE_SHARE
) -> NDArray[np.bool_]:
    """Tell which surface points are seen, by the left camera, where the pipe's face should be.

    Returns:
        (N,) bool. Says nothing of the points' depth: what lies on or before the pipe is included.
    """
    measured = rays_to_axis(surface.rays, camera, axis)
    limb = np.maximum(radius * share, 0.0)
    border = _BORDER * working_factor(camera.width) * measured[:, 1] / camera.fx
    margin = np.minimum(radius - border, limb)
    mask: NDArray[np.bool_] = (
        (np.abs(measured[:, 0]) < margin) & (measured[:, 1] > 0.0) & (np.abs(measured[:, 2]) < SPAN)
    )
    return mask


def _scale(camera: Camera) -> float:
    return max(1.0, camera.width / REFERENCE_WIDTH)


def without_sag(surface: SurfacePoints, camera: Camera, axis: Axis, radius: float) -> SurfacePoints:
    """Put points on the pipe's face to where its surface is.

    A patch is matched as a plane. Over the round of the pipe that plane lies deeper than the
    surface at the patch's middle, by half the curvature times the mean square of its reach: 0.1 cm
    for 0.6 m of pipe 4 m from a camera of 900 px focal length, and more with fewer pixels.

    Args:
        surface: points on the face.
        camera: the left one.
        axis: near which the points lie.
        radius: m.
    """
    if not len(surface.points):
        return surface
    aside = rays_to_axis(surface.rays, camera, axis)[:, 0]
    facing = np.maximum(1.0 - np.square(aside / radius), _LEAST_FACING)
    pixels = surface.points[:, 2] * working_factor(camera.width) / camera.fx
    sag = 0.5 * _PATCH_VARIANCE * np.square(pixels) / (radius * facing)
    normals, _ = distances_from_axis(surface.points, axis)
    return replace(surface, points=surface.points + sag[:, None] * normals)


def point_sigmas(surface: SurfacePoints, axis: Axis) -> Array:
    """Return the standard deviation of each point's distance from the axis, (N,), m."""
    normals, _ = distances_from_axis(surface.points, axis)
    facing = np.abs(np.einsum("ij,ij->i", normals, surface.rays))
    # Seen along the surface, a point's error is one of place, not of depth; keep a little.
    sigmas: Array = np.hypot(surface.depth_sigmas * np.maximum(facing, 0.2), ROUGHNESS)
    return sigmas


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
    for view, found in zip(
        frame.rig.cameras, (frame.left_segments, frame.right_segments), strict=False
    ):
        rays = unit_rays(found.astype(np.float64).reshape(-1, 2), view)
        measured = rays_to_axis(rays, view, axis)
        reach = _REACH + _REACH_PIXELS * _scale(view) * np.abs(measured[:, 1]) / view.fx
        near = np.abs(np.abs(measured[:, 0]) - radius) < reach
        segments.append(found[near[0::2] & near[1::2]])
    measured = rays_to_axis(surface.rays, frame.rig.left, axis)
    near = (np.abs(measured[:, 0]) < radius + _REACH) & (np.abs(measured[:, 2]) < SPAN + _REACH)
    right = segments[1] if len(segments) > 1 else frame.right_segments
    part = replace(frame, left_segments=segments[0], right_segments=right)
    return part, surface.subset(near)


def exposed_points(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float
) -> NDArray[np.bool_]:
    """Tell which points are beside a section of the pipe that is not covered.

    A section is covered (by silt, growth, a fish) where less than half of the points on its face
    lie on the pipe.

    Returns:
        (N,) bool.
    """
    measured = rays_to_axis(surface.rays, camera, axis)
    count = int(2.0 * SPAN / _SECTION) + 1
    section = np.clip(((measured[:, 2] + SPAN) / _SECTION).astype(np.int64), 0, count - 1)
    face = on_face(surface, camera, axis, radius)
    part = without_sag(surface.subset(face), camera, axis, radius)
    _, distance = distances_from_axis(part.points, axis)
    on = np.abs(distance - radius) < _ON_FACE * point_sigmas(part, axis)
    all_points = np.bincount(section[face], minlength=count)
    on_points = np.bincount(section[face], weights=on, minlength=count)
    covered = (all_points >= _SECTION_POINTS) & (on_points < 0.5 * all_points)
    exposed: NDArray[np.bool_] = ~covered[section]
    return exposed


def contour_rays(
    segments: Float32Array,
    camera: Camera,
    axis: Axis,
    radius: float,
    gate: float,
    angle: float = 0.12,
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
    if segments.shape[0] == 0:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    rays = unit_rays(segments.astype(np.float64).reshape(-1, 2), camera)
    measured = rays_to_axis(rays, camera, axis)
    pixels_per_metre = camera.fx / np.maximum(measured[:, 1], 0.05)
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).astype(np.float64).T)
    side = np.sign(measured[:, 0])
    off = (np.abs(measured[:, 0]) - radius) * pixels_per_metre
    first, second = off[0::2], off[1::2]
    same = (side[0::2] == side[1::2]) & (measured[0::2, 1] > 0) & (measured[1::2, 1] > 0)
    near = np.maximum(np.abs(first), np.abs(second)) < gate
    parallel = np.abs(first - second) < np.maximum(np.sin(angle) * length, 1.5 * _scale(camera))
    within = (np.abs(measured[0::2, 2]) < span) & (np.abs(measured[1::2, 2]) < span)
    mask = np.repeat(same & near & parallel & within, 2)
    weight = np.repeat(length / (2.0 * EDGE_SAMPLE * camera.width / REFERENCE_WIDTH), 2)[mask]
    side = side[mask]
    for own in (side < 0, side > 0):
        weight[own] *= min(1.0, MOST_SAMPLES / max(float(weight[own].sum()), 1e-9))
    return rays[mask], side, weight


def gather(
    frame: VectorizedStereo,
    surface: SurfacePoints,
    axis: Axis,
    radius: float,
    gate: float,
) -> Evidence:
    """Gather what speaks of an axis near a prediction: points on its face, contours near its own.

    Args:
        frame: the vectorized pair.
        surface: its triangulated matches.
        axis: the predicted axis.
        radius: m.
        gate: largest distance of a segment from the predicted contour, px at 1200 px width.
    """
    camera = frame.rig.left
    face = surface.subset(on_face(surface, camera, axis, radius))
    if not face.tells_shape(radius):
        face = face.subset(np.zeros(len(face.points), np.bool_))
    face = without_sag(face, camera, axis, radius)
    rays, origins, sides, weights, sigmas = [], [], [], [], []
    segments = (frame.left_segments, frame.right_segments)
    for view, found in zip(frame.rig.cameras, segments, strict=False):
        scaled = gate * view.width / REFERENCE_WIDTH
        r, s, w = contour_rays(found, view, axis, radius, max(scaled, 2.0))
        rays.append(r)
        sides.append(s)
        weights.append(w)
        origins.append(np.broadcast_to(view.centre, r.shape))
        sigma = max(EDGE_SIGMA * view.width / REFERENCE_WIDTH, 0.6) / view.fx
        sigmas.append(np.full(len(r), sigma))
    return Evidence(
        points=face.points,
        point_sigmas=point_sigmas(face, axis) if len(face.points) else np.zeros(0),
        rays=np.concatenate(rays),
        origins=np.concatenate(origins),
        sides=np.concatenate(sides),
        ray_sigmas=np.concatenate(sigmas),
        ray_weights=np.concatenate(weights),
        point_weight=_POINT_WEIGHT,
    )
