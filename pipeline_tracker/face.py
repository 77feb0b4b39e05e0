"""The pipe's face: the part of its surface that the left camera sees, and the points on it.

Left optical frame throughout. In compiled functions an axis is its rows, and ``pixel`` is what a
pixel of the working size shows for each metre of depth, m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.bent_axis import nearest_to_points, nearest_to_rays
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
# A section is bare where this share of its points lies on the pipe, at least, and this part of what
# it is in the better sections: those beyond this quantile.
_LEAST_ON, _OF_BARE, _BARE = 0.5, 0.75, 0.8
_SECTIONS = int(2.0 * SPAN / _SECTION) + 1


def pixel_of(camera: Camera) -> float:
    """Return what a pixel of the working size shows for each metre of depth, m."""
    return working_factor(camera.width) / camera.fx


@compiled
def _measure_rays(rays: Array, axis: Array) -> Array:
    """Return distance, depth and t, (3, N), of rays (N, 3) of the left camera."""
    measured = np.empty((3, rays.shape[0]))
    nearest_to_rays(axis, 0.0, np.ascontiguousarray(rays.T), measured)
    return measured


@compiled
def _meets_face(
    aside: float, depth: float, t: float, radius: float, share: float, pixel: float
) -> bool:
    """Tell whether a ray that was measured against the axis meets the pipe's face."""
    margin = min(radius - _BORDER * pixel * depth, max(radius * share, 0.0))
    return abs(aside) < margin and depth > 0.0 and abs(t) < SPAN


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
    chosen: NDArray[np.int64],
    asides: Array,
    axis: Array,
    radius: float,
    pixel: float,
    out: Array,
    distances: Array,
    sigmas: Array,
) -> None:
    """Put points of the face to where its surface is, see ``without_sag``, and measure them.

    Args:
        points, rays, depth_sigmas: of the surface.
        chosen: which of them, (K,).
        asides: distances of all rays from the axis, (N,), m.
        axis, radius, pixel: of the pipe and the camera.
        out: (K or more, 3), filled with the points less their sag, m.
        distances, sigmas: (K or more,), filled with their distances from the axis and the standard
            deviations of those, m.
    """
    own, nearest = np.empty((3, chosen.shape[0])), np.empty((5, chosen.shape[0]))
    for k in range(chosen.shape[0]):
        for c in range(3):
            own[c, k] = points[chosen[k], c]
    nearest_to_points(axis, own, nearest)
    for k in range(chosen.shape[0]):
        i = chosen[k]
        vx, vy, vz = nearest[1, k], nearest[2, k], nearest[3, k]
        ratio = asides[i] / radius
        reach = own[2, k] * pixel
        round_ = radius * max(1.0 - ratio * ratio, _LEAST_FACING)
        sag = 0.5 * _PATCH_VARIANCE * reach * reach / round_
        scale = 1.0 / max(nearest[0, k], 1e-9)
        out[k, 0] = own[0, k] + sag * scale * vx
        out[k, 1] = own[1, k] + sag * scale * vy
        out[k, 2] = own[2, k] + sag * scale * vz
        facing = scale * (vx * rays[i, 0] + vy * rays[i, 1] + vz * rays[i, 2])
        distances[k] = nearest[0, k] + sag
        sigmas[k] = distance_sigma(depth_sigmas[i], facing)


@compiled
def _on_face(
    measured: Array, radius: float, share: float, pixel: float, chosen: NDArray[np.int64]
) -> int:
    """Fill the first of ``chosen``, (N,), with the rays that meet the face; how many."""
    count = 0
    for i in range(measured.shape[1]):
        if _meets_face(measured[0, i], measured[1, i], measured[2, i], radius, share, pixel):
            chosen[count] = i
            count += 1
    return count


@compiled
def _face_of_rays(
    rays: Array, axis: Array, radius: float, share: float, pixel: float, mask: Mask
) -> None:
    """Fill the mask, (N,), see ``on_face``."""
    measured = _measure_rays(rays, axis)
    for i in range(rays.shape[0]):
        mask[i] = _meets_face(measured[0, i], measured[1, i], measured[2, i], radius, share, pixel)


def on_face(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float, share: float = FACE_SHARE
) -> Mask:
    """Tell which surface points are seen, by the left camera, where the pipe's face should be.

    Returns:
        (N,) bool. Says nothing of the points' depth: what lies on or before the pipe is included.
    """
    mask = np.empty(len(surface.rays), np.bool_)
    _face_of_rays(surface.rays, axis.rows, radius, share, pixel_of(camera), mask)
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
    n = points.shape[0]
    asides, unused = _measure_rays(rays, axis)[0], np.empty((2, n))
    _put_on_pipe(
        points,
        rays,
        depth_sigmas,
        np.arange(n),
        asides,
        axis,
        radius,
        pixel,
        out,
        unused[0],
        unused[1],
    )


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
    nearest = np.empty((5, points.shape[0]))
    nearest_to_points(axis, np.ascontiguousarray(points.T), nearest)
    for i in range(points.shape[0]):
        facing = 0.0
        for c in range(3):
            facing += nearest[1 + c, i] * rays[i, c]
        out[i] = distance_sigma(depth_sigmas[i], facing / max(nearest[0, i], 1e-9))


def point_sigmas(surface: SurfacePoints, axis: Axis) -> Array:
    """Return the standard deviation of each point's distance from the axis, (N,), m."""
    sigmas = np.empty(len(surface.points))
    _point_sigmas(surface.points, surface.rays, surface.depth_sigmas, axis.rows, sigmas)
    return sigmas


@compiled
def _placed_face(
    points: Array,
    rays: Array,
    depth_sigmas: Array,
    measured: Array,
    axis: Array,
    radius: float,
    pixel: float,
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Return which points are on the face, and of these what ``_put_on_pipe`` fills."""
    room = np.empty(points.shape[0], np.int64)
    chosen = room[: _on_face(measured, radius, FACE_SHARE, pixel, room)]
    placed, found = np.empty((chosen.shape[0], 3)), np.empty((2, chosen.shape[0]))
    _put_on_pipe(
        points,
        rays,
        depth_sigmas,
        chosen,
        measured[0],
        axis,
        radius,
        pixel,
        placed,
        found[0],
        found[1],
    )
    return chosen, placed, found[0], found[1]


@compiled
def _face_evidence(
    points: Array, rays: Array, depth_sigmas: Array, axis: Array, radius: float, pixel: float
) -> tuple[Array, Array]:
    """Return the face's points less their sag, and their sigmas."""
    chosen, placed, _, sigmas = _placed_face(
        points, rays, depth_sigmas, _measure_rays(rays, axis), axis, radius, pixel
    )
    if not tells_shape(depth_sigmas[chosen], radius):
        return placed[:0], sigmas[:0]
    return placed, sigmas


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
    points, sigmas = _face_evidence(
        surface.points, surface.rays, surface.depth_sigmas, axis.rows, radius, pixel_of(camera)
    )
    return points, sigmas


@compiled
def _reached_by(shares: Array, told: Mask, part: float) -> float:
    """Return the largest share that this part of the told sections reaches; 0 where none is told.

    (``np.quantile`` would take seconds to compile.)
    """
    best = 0.0
    for i in range(shares.shape[0]):
        reached = 0
        count = 0
        for j in range(shares.shape[0]):
            if told[j]:
                count += 1
                reached += shares[j] >= shares[i]
        if told[i] and reached >= part * count:
            best = max(best, shares[i])
    return best


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
    n = points.shape[0]
    seen, on = np.zeros(_SECTIONS), np.zeros(_SECTIONS)
    measured = _measure_rays(rays, axis)
    section = np.empty(n, np.int64)
    for i in range(n):
        place = (measured[2, i] + SPAN) / _SECTION
        section[i] = int(min(max(place, 0.0), _SECTIONS - 1.0))
    chosen, _, distances, sigmas = _placed_face(
        points, rays, depth_sigmas, measured, axis, radius, pixel
    )
    for j in range(chosen.shape[0]):
        k = section[chosen[j]]
        seen[k] += 1.0
        if abs(distances[j] - radius) < _ON_FACE * sigmas[j]:
            on[k] += 1.0
    share = on / np.maximum(seen, 1.0)
    told = seen >= _SECTION_POINTS
    least = _LEAST_ON
    # By how many lie on the pipe where it is bare: less where points are poor or growth is all
    # along. Silt that rises through the pipe's surface has some in place, by chance.
    least = max(least, _OF_BARE * _reached_by(share, told, 1.0 - _BARE))
    for i in range(points.shape[0]):
        k = section[i]
        exposed[i] = not (told[k] and share[k] < least)


def exposed_points(surface: SurfacePoints, camera: Camera, axis: Axis, radius: float) -> Mask:
    """Tell which points are beside a section of the pipe that is not covered.

    A section is covered (by silt, growth, a fish) where less than half of the points on its face
    lie on the pipe, or clearly less than in the better sections.

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
