"""Rigid poses (REP 103 axes, metres, unit quaternions x y z w)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """A rigid transform ``a <- b``: it takes coordinates in frame b to frame a.

    Attributes:
        rotation: 3 x 3 rotation matrix, float64.
        translation: origin of b in a, shape (3,), metres, float64.
    """

    rotation: Array
    translation: Array

    @classmethod
    def identity(cls) -> Pose:
        """Return the pose that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, translation: ArrayLike, quaternion: ArrayLike) -> Pose:
        """Build a pose from a translation (3,) in metres and a quaternion (x, y, z, w).

        Raises:
            ValueError: a number is not finite, or the quaternion's norm is further than 1 % from 1.
        """
        position = np.asarray(translation, dtype=np.float64).reshape(3)
        q = np.asarray(quaternion, dtype=np.float64).reshape(4)
        norm = float(np.linalg.norm(q))
        if not np.isfinite(position).all():
            raise ValueError(f"position {position.tolist()} is not finite")
        if not 0.99 < norm < 1.01:
            raise ValueError(f"quaternion {q.tolist()} has norm {norm:.4g}, expected 1")
        return cls(_matrix(Rotation.from_quat(q / norm)), position)

    @classmethod
    def from_rpy(cls, translation: ArrayLike, rpy: ArrayLike) -> Pose:
        """Build a pose from roll, pitch, yaw in radians: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        angles = np.asarray(rpy, dtype=np.float64).reshape(3)
        return cls(
            _matrix(Rotation.from_euler("xyz", angles)),
            np.asarray(translation, dtype=np.float64).reshape(3),
        )

    def quaternion(self) -> Array:
        """Return the rotation as a unit quaternion (x, y, z, w), w >= 0."""
        q: Array = Rotation.from_matrix(self.rotation).as_quat()
        return -q if q[3] < 0 else q

    def rpy(self) -> Array:
        """Return roll, pitch, yaw in radians, (3,); see ``from_rpy``."""
        angles: Array = Rotation.from_matrix(self.rotation).as_euler("xyz")
        return angles

    def inverse(self) -> Pose:
        """Return the transform ``b <- a``."""
        transposed = self.rotation.T
        return Pose(transposed, -transposed @ self.translation)

    def __matmul__(self, other: Pose) -> Pose:
        """Chain transforms: (a <- b) @ (b <- c) = (a <- c)."""
        return Pose(
            self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
        )

    def apply(self, points: ArrayLike) -> Array:
        """Transform points of shape (..., 3)."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def rotate(self, vectors: ArrayLike) -> Array:
        """Rotate direction vectors of shape (..., 3)."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T


def interpolate(before: Pose, after: Pose, fraction: float) -> Pose:
    """Interpolate two poses: position linearly, rotation along the shortest arc.

    Args:
        before: pose at fraction 0.
        after: pose at fraction 1.
        fraction: 0 to 1.
    """
    rotations = Rotation.from_matrix(np.stack((before.rotation, after.rotation)))
    rotation = _matrix(Slerp([0.0, 1.0], rotations)([fraction])[0])
    return Pose(rotation, before.translation + fraction * (after.translation - before.translation))


def _matrix(rotation: Rotation) -> Array:
    # A copy: SciPy's own array holds on to 1.2 kB of views, and buffers keep thousands of poses.
    return np.array(rotation.as_matrix())
