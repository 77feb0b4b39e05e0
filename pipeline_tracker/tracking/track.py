"""What is known of the pipe between two frames, carried along by the pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import BEND_SIGMA, Axis, Prior
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipe_segment import middle_of_view

Array = NDArray[np.float64]

# Uncertainty that a displacement adds: at rest, and for each metre of way. The VNM is good to
# centimetres, and a real pipe turns a little from one piece to the next.
_REST = np.array([0.005, 0.005, 0.004, 0.004])
_PER_METRE = np.array([0.03, 0.03, 0.03, 0.03])


@dataclass(frozen=True)
class Track:
    """The pipe's axis as seen from one position of the vehicle.

    Attributes:
        axis: left optical frame, origin in the middle of the view, along travel.
        covariance: 4 x 4: left, up, heading, pitch at the origin.
        pose: odom <- base_link of that position.
        stamp_ns: of that position, ns.
    """

    axis: Axis
    covariance: Array
    pose: Pose
    stamp_ns: int

    def moved_to(self, pose: Pose, stamp_ns: int, mounting: Pose, camera: Camera) -> Track:
        """Carry the axis into the camera frame of another position (4.1, step 1).

        Args:
            pose: odom <- base_link there.
            stamp_ns: its stamp, ns.
            mounting: base_link <- left optical.
            camera: the left camera.
        """
        change = mounting.inverse() @ pose.inverse() @ self.pose @ mounting
        axis = Axis(
            change.apply(self.axis.point),
            change.rotate(self.axis.direction),
            change.rotate(self.axis.bend),
        )
        # A bend measured over the view is not known to go on: it fades with the way.
        shift = middle_of_view(axis, camera)
        axis = Axis(axis.point, axis.direction, axis.bend / (1.0 + abs(shift))).moved(shift)
        way = float(np.linalg.norm(pose.translation - self.pose.translation))
        covariance = self._spread(shift) + np.diag(np.square(_REST + way * _PER_METRE))
        return Track(axis, covariance, pose, stamp_ns)

    def _spread(self, shift: float) -> Array:
        """Covariance at an origin moved along the axis: the angles' errors become offsets."""
        lever = np.eye(4)
        lever[0, 2] = lever[1, 3] = shift
        return lever @ self.covariance @ lever.T

    def prior(self) -> Prior:
        """Return the axis as the prior of a fit."""
        sigmas = np.sqrt(np.diag(self.covariance))
        return Prior(self.axis, np.concatenate((sigmas, [BEND_SIGMA, BEND_SIGMA])))
