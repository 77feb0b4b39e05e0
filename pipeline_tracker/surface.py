"""Surface points: matches of the two images triangulated (4.2.4, technique 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline_tracker.geometry.camera import StereoRig
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
        enough = len(self.points) >= LEAST_FACE_POINTS
        return enough and float(np.median(self.depth_sigmas)) < 0.25 * radius

    def subset(self, mask: NDArray[np.bool_]) -> SurfacePoints:
        """Return the points where the mask, (N,), is true."""
        return SurfacePoints(
            self.points[mask],
            self.rays[mask],
            self.depth_sigmas[mask],
            self.left_pixels[mask],
            self.right_pixels[mask],
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
    places = matches[:, :2]
    disparity = matches[:, 0] - matches[:, 2]
    # Some hundreds of them tell.
    chosen = np.arange(0, len(places), max(1, len(places) // _SAMPLE))
    _, near = cKDTree(places).query(places[chosen], k=_NEIGHBOURS + 1)
    near = near[:, 1:]
    away = places[near] - places[chosen, None, :]
    design = np.concatenate((np.ones((*near.shape, 1)), away), axis=2)
    # A little is added on the diagonal: neighbours in one row span no plane.
    normal = np.einsum("nki,nkj->nij", design, design) + np.diag([1e-6, 1.0, 1.0])
    right = np.einsum("nki,nk->ni", design, disparity[near])
    predicted = np.linalg.solve(normal, right[:, :, None])[:, 0, 0]
    leverage = 1.0 + np.linalg.inv(normal)[:, 0, 0]
    off = np.abs(disparity[chosen] - predicted) / np.sqrt(leverage)
    spread = 1.4826 * float(np.median(off))
    return DISPARITY_SIGMA * max(scale, spread / _RELIEF)


def triangulate(matches: Float32Array, rig: StereoRig) -> SurfacePoints:
    """Triangulate matches of a rectified pair.

    Args:
        matches: (N, 4) float32, x_left y_left x_right y_right, px.
        rig: the two cameras.

    Returns:
        The points before the cameras; matches without a positive disparity are left out, and those
        that are not inside the images.
    """
    found = matches.astype(np.float64)
    size = np.tile([rig.left.width, rig.left.height], 2)
    found = found[((found > -1.0) & (found < size)).all(axis=1)]
    if rig.right is None or found.shape[0] == 0:
        none = np.zeros((0, 3))
        return SurfacePoints(none, none, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)))
    left = rig.left.rays(found[:, :2])
    right = rig.right.rays(found[:, 2:])
    parallax = left[:, 0] - right[:, 0]
    pixel = disparity_sigma(found, rig.left.width) / rig.left.fx
    # A parallax within its own noise gives no distance at all.
    mask = parallax > 4.0 * pixel
    left, parallax, found = left[mask], parallax[mask], found[mask]
    depth = rig.baseline / parallax
    lengths = np.linalg.norm(left, axis=1)
    return SurfacePoints(
        points=left * depth[:, None],
        rays=left / lengths[:, None],
        depth_sigmas=lengths * depth * pixel / parallax,
        left_pixels=found[:, :2],
        right_pixels=found[:, 2:],
    )
