"""The pipe's face: the part of its surface that the left camera sees, and the points on it.

Left optical frame throughout. In compiled functions an axis is its rows, and ``pixel`` is what a
pixel of the working size shows for each metre of depth, m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.bent_axis import nearest_to_point, nearest_to_ray
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.surface import SurfacePoints, tells_shape
from pipeline_tracker.vectorization.patch_alignment import patch_variance
from pipeline_tracker.vectorization.working_size import working_factor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
# Only so much of the axis to each side of the middle is fitted, m: one bend describes no more of a
# real pipe than that.
SPAN = 1.75
# Sections by which a covered stretch is told, m, their least points, and how far off a point still
# lies on the pipe, in standard deviations.
_SECTION, _SECTION_POINTS, _ON_FACE = 0.2, 8, 3.0
_SECTIONS = int(2.0 * SPAN / _SECTION) + 1


def pixel_of(camera: Camera) -> float:
    """Return what a pixel of the working size shows for each metre of depth, m."""
    return working_factor(camera.width) / camera.fx


@compiled
def _sees_face(
    rays: Array, i: int, axis: Array, radius: float, share: float, pixel: float
) -> tuple[bool, float, float]:
    """Tell whether ray i of the left camera meets the pipe's face.

    Returns:
        That; the ray's distance from the axis, m, and t of the axis there, m.
    """
    aside, depth, t, _, _, _ = nearest_to_ray(axis, 0.0, rays[i, 0], rays[i, 1], rays[i, 2])
    margin = min(radius - _BORDER * pixel * depth, max(radius * share, 0.0))
    return abs(aside) < margin and depth > 0.0 and abs(t) < SPAN, aside, t


@compiled
def distance_sigma(depth_sigma: float, facing: float) -> float:
    """Return the standard deviation of a point's distance from the axis, m.

    Args:
        depth_sigma: that of its depth, m.
        facing: cosine between its ray and the surface's normal.
    """
    # Seen along the surface, a point's error is one of place, not of depth; keep a little.
    across = depth_sigma * max(abs(facing), 0.2)
    return float(np.sqrt(across * across + ROUGHNESS * ROUGHNESS))


@compiled
def _put_on_pipe(
    points: Array,
    rays: Array,
    depth_sigmas: Array,
    i: int,
    aside: float,
    axis: Array,
    radius: float,
    pixel: float,
    out: Array,
    k: int,
) -> tuple[float, float]:
    """Put point i of the face to where its surface is, see ``without_sag``, and measure it.

    Args:
        points, rays, depth_sigmas, i: the point.
        aside: distance of its ray from the axis, m.
        axis, radius, pixel: of the pipe and the camera.
        out, k: row k is filled with the point less its sag, m.

    Returns:
        Its distance from the axis and the standard deviation of that, m.
    """
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    distance, vx, vy, vz, _ = nearest_to_point(axis, x, y, z)
    ratio = aside / radius
    reach = z * pixel
    round_ = radius * max(1.0 - ratio * ratio, _LEAST_FACING)
    sag = 0.5 * _PATCH_VARIANCE * reach * reach / round_
    scale = 1.0 / max(distance, 1e-9)
    out[k, 0] = x + sag * scale * vx
    out[k, 1] = y + sag * scale * vy
    out[k, 2] = z + sag * scale * vz
    facing = scale * (vx * rays[i, 0] + vy * rays[i, 1] + vz * rays[i, 2])
    return distance + sag, distance_sigma(depth_sigmas[i], facing)


@compiled
def _on_face(
    rays: Array, axis: Array, radius: float, share: float, pixel: float, mask: Mask
) -> None:
    """Fill the mask, (N,)."""
    for i in range(rays.shape[0]):
        mask[i], _, _ = _sees_face(rays, i, axis, radius, share, pixel)


def on_face(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float, share: float = FACE_SHARE
) -> Mask:
    """Tell which surface points are seen, by the left camera, where the pipe's face should be.

    Returns:
        (N,) bool. Says nothing of the points' depth: what lies on or before the pipe is included.
    """
    mask = np.empty(len(surface.rays), np.bool_)
    _on_face(surface.rays, axis.rows, radius, share, pixel_of(camera), mask)
    return mask


@compiled
def _without_sag(
    points: Array,
    rays: Array,
    depth_sigmas: Array,
    axis: Array,
    radius: float,
    pixel: float,
    out: Array,
) -> None:
    """Fill the points less their sag, (N, 3)."""
    for i in range(points.shape[0]):
        aside, _, _, _, _, _ = nearest_to_ray(axis, 0.0, rays[i, 0], rays[i, 1], rays[i, 2])
        _put_on_pipe(points, rays, depth_sigmas, i, aside, axis, radius, pixel, out, i)


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
    points = np.empty_like(surface.points)
    _without_sag(
        surface.points,
        surface.rays,
        surface.depth_sigmas,
        axis.rows,
        radius,
        pixel_of(camera),
        points,
    )
    return replace(surface, points=points)


@compiled
def _point_sigmas(points: Array, rays: Array, depth_sigmas: Array, axis: Array, out: Array) -> None:
    """Fill the standard deviations, (N,)."""
    for i in range(points.shape[0]):
        distance, vx, vy, vz, _ = nearest_to_point(axis, points[i, 0], points[i, 1], points[i, 2])
        facing = (vx * rays[i, 0] + vy * rays[i, 1] + vz * rays[i, 2]) / max(distance, 1e-9)
        out[i] = distance_sigma(depth_sigmas[i], facing)


def point_sigmas(surface: SurfacePoints, axis: Axis) -> Array:
    """Return the standard deviation of each point's distance from the axis, (N,), m."""
    sigmas = np.empty(len(surface.points))
    _point_sigmas(surface.points, surface.rays, surface.depth_sigmas, axis.rows, sigmas)
    return sigmas


@compiled
def _face_evidence(
    points: Array,
    rays: Array,
    depth_sigmas: Array,
    axis: Array,
    radius: float,
    pixel: float,
    out: Array,
    sigmas: Array,
) -> int:
    """Fill the first rows with the face's points less their sag, and their sigmas; how many."""
    count = 0
    own_sigmas = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        seen, aside, _ = _sees_face(rays, i, axis, radius, FACE_SHARE, pixel)
        if seen:
            own_sigmas[count] = depth_sigmas[i]
            _, sigmas[count] = _put_on_pipe(
                points, rays, depth_sigmas, i, aside, axis, radius, pixel, out, count
            )
            count += 1
    return count if tells_shape(own_sigmas[:count], radius) else 0


def face_evidence(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float
) -> tuple[Array, Array]:
    """Return the points on the face where its surface is, and how well they are known.

    Args:
        surface: triangulated matches.
        camera: the left one.
        axis: near which the pipe is.
        radius: m.

    Returns:
        Points (N, 3), m, and standard deviations of their distance from the axis, (N,), m; none
        where they do not tell the surface's shape.
    """
    points, sigmas = np.empty_like(surface.points), np.empty(len(surface.points))
    count = _face_evidence(
        surface.points,
        surface.rays,
        surface.depth_sigmas,
        axis.rows,
        radius,
        pixel_of(camera),
        points,
        sigmas,
    )
    return points[:count], sigmas[:count]


@compiled
def _exposed(
    points: Array,
    rays: Array,
    depth_sigmas: Array,
    axis: Array,
    radius: float,
    pixel: float,
    exposed: Mask,
) -> None:
    """Fill the mask, (N,)."""
    seen, on = np.zeros(_SECTIONS), np.zeros(_SECTIONS)
    section = np.empty(points.shape[0], np.int64)
    place = np.empty((1, 3))
    for i in range(points.shape[0]):
        sees, aside, t = _sees_face(rays, i, axis, radius, FACE_SHARE, pixel)
        k = int(min(max((t + SPAN) / _SECTION, 0.0), _SECTIONS - 1.0))
        section[i] = k
        if sees:
            distance, sigma = _put_on_pipe(
                points, rays, depth_sigmas, i, aside, axis, radius, pixel, place, 0
            )
            seen[k] += 1.0
            if abs(distance - radius) < _ON_FACE * sigma:
                on[k] += 1.0
    for i in range(points.shape[0]):
        k = section[i]
        exposed[i] = not (seen[k] >= _SECTION_POINTS and on[k] < 0.5 * seen[k])


def exposed_points(surface: SurfacePoints, camera: Camera, axis: Axis, radius: float) -> Mask:
    """Tell which points are beside a section of the pipe that is not covered.

    A section is covered (by silt, growth, a fish) where less than half of the points on its face
    lie on the pipe.

    Returns:
        (N,) bool.
    """
    exposed = np.empty(len(surface.points), np.bool_)
    _exposed(
        surface.points,
        surface.rays,
        surface.depth_sigmas,
        axis.rows,
        radius,
        pixel_of(camera),
        exposed,
    )
    return exposed
