"""Surface points: matches of the two images triangulated (4.2.4, technique 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]

# Standard deviation of a match's disparity, px of an image of at most WORKING_WIDTH.
DISPARITY_SIGMA = 0.15
WORKING_WIDTH = 1600


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

    def subset(self, mask: NDArray[np.bool_]) -> SurfacePoints:
        """Return the points where the mask, (N,), is true."""
        return SurfacePoints(
            self.points[mask],
            self.rays[mask],
            self.depth_sigmas[mask],
            self.left_pixels[mask],
            self.right_pixels[mask],
        )


def triangulate(matches: Float32Array, rig: StereoRig) -> SurfacePoints:
    """Triangulate matches of a rectified pair.

    Args:
        matches: (N, 4) float32, x_left y_left x_right y_right, px.
        rig: the two cameras.

    Returns:
        The points before the cameras; matches without a positive disparity are left out.
    """
    found = matches.astype(np.float64)
    if rig.right is None or found.shape[0] == 0:
        none = np.zeros((0, 3))
        return SurfacePoints(none, none, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)))
    left = rig.left.rays(found[:, :2])
    right = rig.right.rays(found[:, 2:])
    parallax = left[:, 0] - right[:, 0]
    pixel = DISPARITY_SIGMA * max(1.0, rig.left.width / WORKING_WIDTH) / rig.left.fx
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
