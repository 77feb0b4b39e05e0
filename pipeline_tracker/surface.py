"""Surface points: matches of the two images triangulated (4.2.4, technique 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.neighbours import neighbours
from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array
from pipeline_tracker.vectorization.working_size import working_factor

Array = NDArray[np.float64]

# Standard deviation of a match's disparity, px of an image at its working size.
DISPARITY_SIGMA = 0.1
# Disparities of neighbours differ by the noise and by the relief of the bed: up to this, px, on
# rendered beds. More means poor matches (no texture, a pair that is not well rectified).
_RELIEF = 0.45
_NEIGHBOURS = 6
_LEAST_MATCHES = 30
_SAMPLE = 300
# Fewer points on a face than this say nothing about its shape.
LEAST_FACE_POINTS = 12
# ... nor do points whose depth is less sure than this share of the radius, by the median.
_TELLING_SHARE = 0.25


@compiled
def tells_shape(depth_sigmas: Array, radius: float) -> bool:
    """Whether depths of these sigmas, (N,), m, tell a pipe of a radius, m, from a plane."""
    if depth_sigmas.shape[0] < LEAST_FACE_POINTS:
        return False
    return bool(np.median(depth_sigmas) < _TELLING_SHARE * radius)


@dataclass(frozen=True)
class SurfacePoints:
    """Triangulated matches in the left optical frame.

    Attributes:
        points: (N, 3), m.
        rays: (N, 3) unit directions from the left camera.
        depth_sigmas: (N,) standard deviation of the distance along the ray, m.
        left_pixels, right_pixels: (N, 2), px.
    """

    points: Array
    rays: Array
    depth_sigmas: Array
    left_pixels: Array
    right_pixels: Array

    def tells_shape(self, radius: float) -> bool:
        """Whether the depths are good enough, and many enough, to tell a pipe from a plane.

        Args:
            radius: of the pipe, m.
        """
        return tells_shape(self.depth_sigmas, radius)

    def subset(self, mask: NDArray[np.bool_]) -> SurfacePoints:
        """Return the points where the mask, (N,), is true."""
        chosen = np.flatnonzero(mask)
        return SurfacePoints(
            self.points.take(chosen, axis=0),
            self.rays.take(chosen, axis=0),
            self.depth_sigmas.take(chosen),
            self.left_pixels.take(chosen, axis=0),
            self.right_pixels.take(chosen, axis=0),
        )


def disparity_sigma(matches: Array, width: int) -> float:
    """Return the standard deviation of the disparities of a frame, px.

    Measured on the frame itself: how far a disparity is from the plane through those of its
    nearest neighbours in the picture.

    Args:
        matches: (N, 4), x_left y_left x_right y_right, px.
        width: of the image, px.
    """
    scale = float(working_factor(width))
    if len(matches) < _LEAST_MATCHES:
        return DISPARITY_SIGMA * scale
    # Some hundreds of them tell.
    chosen = np.arange(0, len(matches), max(1, len(matches) // _SAMPLE))
    matches = np.ascontiguousarray(matches, np.float64)
    off = np.empty(len(chosen))
    _off_neighbours(matches, chosen, neighbours(matches, chosen, _NEIGHBOURS), off)
    spread = 1.4826 * float(np.median(off))
    return DISPARITY_SIGMA * max(scale, spread / _RELIEF)


@compiled
def _off_neighbours(
    matches: Array, chosen: NDArray[np.int64], near: NDArray[np.int64], off: Array
) -> None:
    """Fill how far disparities are from the plane through those of their neighbours, (K,), px.

    Args:
        matches: (N, 4), px.
        chosen: (K,) indices of those that are looked at.
        near: (K, M) indices of their neighbours.
        off: in units of what is expected of a disparity of noise 1.
    """
    for j in range(chosen.shape[0]):
        i = chosen[j]
        # A little is added on the diagonal: neighbours in one row span no plane.
        s00, s11, s22 = 1e-6, 1.0, 1.0
        s01 = s02 = s12 = 0.0
        r0 = r1 = r2 = 0.0
        for other in near[j]:
            x = matches[other, 0] - matches[i, 0]
            y = matches[other, 1] - matches[i, 1]
            disparity = matches[other, 0] - matches[other, 2]
            s00 += 1.0
            s01 += x
            s02 += y
            s11 += x * x
            s12 += x * y
            s22 += y * y
            r0 += disparity
            r1 += x * disparity
            r2 += y * disparity
        # The first row of the inverse of the normal equations.
        c0, c1, c2 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
        determinant = s00 * c0 + s01 * c1 + s02 * c2
        predicted = (c0 * r0 + c1 * r1 + c2 * r2) / determinant
        own = matches[i, 0] - matches[i, 2]
        off[j] = abs(own - predicted) / np.sqrt(1.0 + c0 / determinant)


def triangulate(matches: Float32Array, rig: StereoRig) -> SurfacePoints:
    """Triangulate matches of a rectified pair.

    Args:
        matches: (N, 4) float32, x_left y_left x_right y_right, px.
        rig: the two cameras.

    Returns:
        The points before the cameras; matches without a positive disparity are left out, and those
        that are not inside the images.
    """
    room = np.empty((len(matches), 4))
    found = room[: _inside(matches, rig.left.width, rig.left.height, room)]
    if rig.right is None or found.shape[0] == 0:
        none = np.zeros((0, 3))
        return SurfacePoints(none, none, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)))
    pixel = disparity_sigma(found, rig.left.width) / rig.left.fx
    points, rays = np.empty((len(found), 3)), np.empty((len(found), 3))
    sigmas = np.empty(len(found))
    count = _triangulate(found, rig.left.numbers, rig.right.numbers, pixel, points, rays, sigmas)
    return SurfacePoints(
        points=points[:count],
        rays=rays[:count],
        depth_sigmas=sigmas[:count],
        left_pixels=found[:count, :2],
        right_pixels=found[:count, 2:],
    )


@compiled
def _inside(matches: Float32Array, width: int, height: int, out: Array) -> int:
    """Fill the first rows with the matches that are inside both images; how many."""
    count = 0
    for i in range(matches.shape[0]):
        inside = True
        for c in range(4):
            out[count, c] = matches[i, c]
            inside &= -1.0 < out[count, c] < (height if c % 2 else width)
        count += inside
    return count


@compiled
def _triangulate(
    matches: Array,
    left: Array,
    right: Array,
    pixel: float,
    points: Array,
    rays: Array,
    sigmas: Array,
) -> int:
    """Fill the first rows with points, rays and sigmas of the depth; how many.

    Args:
        matches: (N, 4), px; those of the points are moved to the first rows.
        left, right: numbers of the cameras.
        pixel: standard deviation of a parallax.
        points, rays, sigmas: (N, 3), (N, 3), (N,), filled.
    """
    count = 0
    for i in range(matches.shape[0]):
        x = (matches[i, 0] - left[2]) / left[0]
        y = (matches[i, 1] - left[3]) / left[1]
        parallax = x - (matches[i, 2] - right[2]) / right[0]
        # A parallax within its own noise gives no distance at all.
        if not parallax > 4.0 * pixel:
            continue
        for c in range(4):
            matches[count, c] = matches[i, c]
        depth = (right[6] - left[6]) / parallax
        length = np.sqrt(x * x + y * y + 1.0)
        points[count, 0], points[count, 1], points[count, 2] = x * depth, y * depth, depth
        rays[count, 0], rays[count, 1], rays[count, 2] = x / length, y / length, 1.0 / length
        sigmas[count] = length * depth * pixel / parallax
        count += 1
    return count
