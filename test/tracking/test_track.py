"""The axis carried along by the pose, and how its uncertainty grows (4.1, step 1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from synthetic_world import LEFT, TILTED, level_pose

from pipeline_tracker.axis_fit import BEND_SIGMA, Axis
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.tracking.track import Track

Array = NDArray[np.float64]

# An axis 2 m below odom's origin, in odom.
POINT, DIRECTION = np.array([0.5, 0.2, -2.0]), np.array([0.98, 0.17, 0.1])
SURE = np.diag(np.square([0.003, 0.004, 0.002, 0.005]))


def track(pose: Pose, bend: Array | None = None) -> Track:
    to_optical = (pose @ TILTED).inverse()
    axis = Axis.straight(to_optical.apply(POINT), to_optical.rotate(DIRECTION))
    if bend is not None:
        bend = bend - axis.direction * (bend @ axis.direction)
        axis = Axis(axis.point, axis.direction, bend)
    return Track(axis, SURE, pose, 0)


small = st.floats(-0.5, 0.5)


@given(small, small, small, small, small, small)
@settings(max_examples=30)
def test_the_axis_stays_where_it_is_in_the_world(
    x: float, y: float, z: float, roll: float, pitch: float, yaw: float
) -> None:
    there = Pose.from_rpy([x, y, z], [0.5 * roll, 0.5 * pitch, yaw])
    moved = track(level_pose()).moved_to(there, 7, TILTED, LEFT)
    assert moved.stamp_ns == 7
    assert moved.pose is there
    to_odom = there @ TILTED
    unit = DIRECTION / np.linalg.norm(DIRECTION)
    assert np.allclose(to_odom.rotate(moved.axis.direction), unit)
    off = to_odom.apply(moved.axis.point) - POINT
    assert np.linalg.norm(np.cross(off, unit)) < 1e-9
    # Its origin is in the middle of the new view; where that is out of view, at its border.
    away = float(moved.axis.point[:2] @ moved.axis.direction[:2])
    pixel = LEFT.project(moved.axis.point)
    border = np.min(np.abs([pixel + 0.5, pixel - [1199.5, 799.5]]))
    assert abs(away) < 1e-6 or border < 1e-3


def test_uncertainty_grows_with_the_way_and_the_lever() -> None:
    start = track(level_pose())
    at_rest = np.diag(start.moved_to(level_pose(), 1, TILTED, LEFT).covariance)
    near = np.diag(start.moved_to(level_pose(x=0.3), 1, TILTED, LEFT).covariance)
    far = np.diag(start.moved_to(level_pose(x=1.0), 1, TILTED, LEFT).covariance)
    assert (at_rest > np.diag(SURE)).all()
    assert (near > at_rest).all()
    assert (far > near).all()
    moved = start.moved_to(level_pose(x=1.0), 1, TILTED, LEFT)
    assert np.linalg.eigvalsh(moved.covariance).min() > 0.0
    # An error of heading is one of place 1 m on; both then go together.
    assert moved.covariance[0, 2] > 0.0
    assert moved.covariance[1, 3] > 0.0


def test_a_bend_fades_with_the_way() -> None:
    bend = np.array([0.03, 0.0, 0.0])
    start = track(level_pose(), bend)
    sizes = [
        float(np.linalg.norm(start.moved_to(level_pose(x=x), 1, TILTED, LEFT).axis.bend))
        for x in (0.0, 0.5, 2.0)
    ]
    assert sizes[0] > sizes[1] > sizes[2] > 0.0


def test_the_prior_is_the_carried_axis_with_its_sigmas() -> None:
    moved = track(level_pose()).moved_to(level_pose(x=0.3), 1, TILTED, LEFT)
    prior = moved.prior()
    assert prior.axis is moved.axis
    assert prior.sigmas[:4] == pytest.approx(np.sqrt(np.diag(moved.covariance)))
    assert prior.sigmas[4:].tolist() == [BEND_SIGMA, BEND_SIGMA]
