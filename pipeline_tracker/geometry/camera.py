"""The rectified stereo rig.

Pixel coordinates: centres of pixels at integers, x right, y down, in the rectified image.
Camera coordinates: ROS optical frame of the left rectified camera, x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline_tracker.errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A rectified pinhole camera: the left 3 x 3 of CameraInfo's P, and the image size.

    Attributes:
        fx, fy: focal lengths, px.
        cx, cy: principal point, px.
        width, height: image size, px.
        offset: x of the camera's centre in the left camera's frame, m (0 for the left camera).
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    offset: float = 0.0

    @property
    def matrix(self) -> Array:
        """K, 3 x 3."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def numbers(self) -> Array:
        """The attributes in their order, (7,), as compiled kernels take them."""
        return np.array(
            [self.fx, self.fy, self.cx, self.cy, self.width, self.height, self.offset], np.float64
        )

    @property
    def centre(self) -> Array:
        """The camera's centre in the left camera's frame, (3,), m."""
        return np.array([self.offset, 0.0, 0.0])

    def project(self, points: ArrayLike) -> Array:
        """Project points (..., 3) of the left camera's frame to pixels (..., 2).

        The caller sees to it that they lie before the camera (z > 0).
        """
        p = np.asarray(points, dtype=np.float64)
        x = self.fx * (p[..., 0] - self.offset) / p[..., 2] + self.cx
        y = self.fy * p[..., 1] / p[..., 2] + self.cy
        return np.stack((x, y), axis=-1)

    def rays(self, pixels: ArrayLike) -> Array:
        """Return directions (..., 3), z = 1, in which the pixels (..., 2) are seen."""
        p = np.asarray(pixels, dtype=np.float64)
        x = (p[..., 0] - self.cx) / self.fx
        y = (p[..., 1] - self.cy) / self.fy
        return np.stack((x, y, np.ones_like(x)), axis=-1)


@dataclass(frozen=True)
class StereoRig:
    """Left and right rectified camera; ``right`` is None in mono."""

    left: Camera
    right: Camera | None = None

    @property
    def baseline(self) -> float:
        """Distance between the camera centres, m; 0 in mono."""
        return 0.0 if self.right is None else self.right.offset

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The one or two cameras, left first."""
        return (self.left,) if self.right is None else (self.left, self.right)


def camera_from_projection(
    p: ArrayLike, width: int, height: int, *, name: str = "camera_info"
) -> Camera:
    """Build a camera from CameraInfo's P (row-major, 12 numbers) and image size.

    Args:
        p: projection matrix, 3 x 4 or 12 numbers; P[0, 3] = -fx * offset.
        width: image width, px.
        height: image height, px.
        name: what to call the calibration in an error.

    Raises:
        CalibrationError: P is not finite, is zero, has a non-positive focal length or skew,
            or the size is zero.
    """
    matrix = np.asarray(p, dtype=np.float64).reshape(3, 4)
    if not np.isfinite(matrix).all():
        raise CalibrationError(f"{name}: P has a number that is not finite; calibrate the camera")
    if width <= 0 or height <= 0:
        raise CalibrationError(
            f"{name}: image size is {width} x {height}, expected both above 0; calibrate the camera"
        )
    fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
    if not (fx > 0 and fy > 0):
        raise CalibrationError(
            f"{name}: P has focal lengths fx={fx:g}, fy={fy:g}, expected both above 0; "
            "calibrate the camera (rectified calibration, matrix P)"
        )
    rest = [matrix[0, 1], matrix[1, 0], matrix[1, 3], matrix[2, 0], matrix[2, 1], matrix[2, 3]]
    if any(abs(v) > 1e-6 * fx for v in rest) or abs(matrix[2, 2] - 1.0) > 1e-6:
        raise CalibrationError(
            f"{name}: P is not that of a rectified camera beside another along x "
            "(skew, rotation or vertical baseline); rectify the pair"
        )
    return Camera(
        fx=fx,
        fy=fy,
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        width=int(width),
        height=int(height),
        offset=-float(matrix[0, 3]) / fx,
    )


def stereo_rig(left: Camera, right: Camera | None) -> StereoRig:
    """Put two rectified cameras together and check that they are a rectified pair.

    Raises:
        CalibrationError: other sizes, other rows (fy, cy), or a baseline that is not positive.
    """
    if right is None:
        return StereoRig(left, None)
    if abs(left.offset) > 1e-9:
        raise CalibrationError(
            f"left camera_info: P[0,3] gives an offset of {left.offset:g} m, expected 0; "
            "are left and right swapped?"
        )
    if not right.offset > 0:
        raise CalibrationError(
            f"right camera_info: P[0,3] gives a baseline of {right.offset:g} m, expected above 0; "
            "P[0,3] must be -fx * baseline"
        )
    if (left.width, left.height) != (right.width, right.height):
        raise CalibrationError(
            f"images differ in size: left {left.width} x {left.height}, "
            f"right {right.width} x {right.height}; rectify the pair to one size"
        )
    if abs(left.fy - right.fy) > 1e-3 * left.fy or abs(left.cy - right.cy) > 0.5:
        raise CalibrationError(
            f"rows do not agree: left fy={left.fy:g} cy={left.cy:g}, "
            f"right fy={right.fy:g} cy={right.cy:g}; rectify the pair"
        )
    return StereoRig(left, right)
