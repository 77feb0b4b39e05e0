"""The cameras as they are built: lens distortion, and not quite parallel.

A stereo calibration describes each camera by its own matrix K and distortion D, and by R, which
turns its directions to those of the rectified camera, which is a pinhole with matrix P. Rays are
cast through the pixels of the camera as it is, never through a warped image: silhouettes stay
geometric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.distortion import distort, undistort
from pipeline_tracker.simulation.vehicle_models import CameraModel

Array = NDArray[np.float64]

# The inverse of the distortion is checked to this many pixels, at so many pixels each way.
_EXACT, _CHECKED = 1e-3, 41
_EQUIDISTANT = "equidistant"


@dataclass(frozen=True)
class Lens:
    """A camera as it is built.

    Attributes:
        camera: the rectified camera that belongs to it.
        matrix: K, 3 x 3, of the camera itself.
        coefficients: D; empty for images that come rectified.
        model: of the distortion, as CameraInfo names it.
        rotation: R, rectified <- own directions, 3 x 3.
    """

    camera: Camera
    matrix: Array
    coefficients: Array
    model: str
    rotation: Array

    @property
    def rectified(self) -> bool:
        """Whether its images come rectified."""
        return self.coefficients.size == 0

    def sight(self, pixels: Array) -> Array:
        """Return in which directions pixels (N, 2) look: (N, 2), x and y at z = 1, own frame."""
        focal = np.array([self.matrix[0, 0], self.matrix[1, 1]])
        bent: Array = (pixels - self.matrix[:2, 2]) / focal
        if self.rectified:
            return bent
        return undistort(bent, self.model == _EQUIDISTANT, self.coefficients)

    def rays(self, pixels: ArrayLike) -> Array:
        """Return unit directions (..., 3) of pixels (..., 2) in the rectified camera's frame."""
        places = np.asarray(pixels, dtype=np.float64)
        sight = self.sight(places.reshape(-1, 2))
        directions = np.concatenate([sight, np.ones((len(sight), 1))], axis=1) @ self.rotation.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return directions.reshape(*places.shape[:-1], 3)

    def project(self, points: ArrayLike) -> Array:
        """Return the pixels (..., 2) of points (..., 3), z > 0, rectified camera's own frame."""
        places = np.asarray(points, dtype=np.float64)
        own = places.reshape(-1, 3) @ self.rotation
        sight = own[:, :2] / own[:, 2:]
        if not self.rectified:
            sight = distort(sight, self.model == _EQUIDISTANT, self.coefficients)
        pixels: Array = (
            sight * np.array([self.matrix[0, 0], self.matrix[1, 1]]) + self.matrix[:2, 2]
        )
        return pixels.reshape(*places.shape[:-1], 2)


def lenses_of(model: CameraModel) -> tuple[Lens, ...]:
    """Return the cameras as they are built, left first; one in mono.

    Raises:
        SettingsError: the distortion folds the image: a pixel has no direction of its own.
    """
    lenses = tuple(_lens(model, camera, n) for n, camera in enumerate(model.rig().cameras))
    for lens in lenses:
        _check_unfolded(lens)
    return lenses


def _lens(model: CameraModel, camera: Camera, index: int) -> Lens:
    raw = model.distortion
    if raw is None:
        return Lens(camera, camera.matrix, np.zeros(0), "plumb_bob", np.eye(3))
    matrix = camera.matrix
    matrix[:2, :2] *= raw.focal_share
    matrix[:2, 2] += raw.shifts[index]
    turn = Pose.from_rpy(np.zeros(3), np.deg2rad(raw.turns_deg[index]))
    return Lens(camera, matrix, np.array(raw.coefficients), raw.model, turn.rotation)


def _check_unfolded(lens: Lens) -> None:
    if lens.rectified:
        return
    width, height = lens.camera.width, lens.camera.height
    x, y = (np.linspace(-0.5, size - 0.5, _CHECKED) for size in (width, height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    with np.errstate(all="ignore"):
        gaps = np.linalg.norm(lens.project(lens.rays(pixels)) - pixels, axis=1)
    # Written so that NaN counts as wrong.
    wrong = ~(gaps < _EXACT)
    if wrong.any():
        first = pixels[np.argmax(wrong)]
        raise SettingsError(
            f"camera.distortion.coefficients={lens.coefficients.tolist()} leave the pixel "
            f"({first[0]:.0f}, {first[1]:.0f}) without a direction of its own, expected an image "
            "that does not fold; choose weaker ones or a smaller camera.field_of_view_deg"
        )
