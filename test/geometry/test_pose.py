"""Poses against elementary rotations written out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose, interpolate

Array = NDArray[np.float64]

angles = st.floats(-3.1, 3.1)
metres = st.floats(-50.0, 50.0)


def rpy_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll) from its three factors."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(rz @ ry @ rx)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    position = [draw(metres) for _ in range(3)]
    return Pose.from_rpy(position, [draw(angles) for _ in range(3)])


@given(angles, st.floats(-1.5, 1.5), angles)
def test_rpy_is_yaw_after_pitch_after_roll(roll: float, pitch: float, yaw: float) -> None:
    pose = Pose.from_rpy([1.0, 2.0, 3.0], [roll, pitch, yaw])
    np.testing.assert_allclose(pose.rotation, rpy_matrix(roll, pitch, yaw), atol=1e-12)
    np.testing.assert_array_equal(pose.translation, [1.0, 2.0, 3.0])


def test_camera_straight_down_sees_forward_at_the_top() -> None:
    mounting = Pose.from_rpy([0.3, 0.0, -0.1], [math.pi, 0.0, -math.pi / 2.0])
    # Optical axes in base_link: x to starboard, y backwards, z down.
    np.testing.assert_allclose(mounting.rotate([1.0, 0.0, 0.0]), [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(mounting.rotate([0.0, 1.0, 0.0]), [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(mounting.apply([0.0, 0.0, 2.0]), [0.3, 0.0, -2.1], atol=1e-12)


@given(poses(), poses(), st.lists(metres, min_size=3, max_size=3))
def test_chain_and_inverse(first: Pose, second: Pose, point: list[float]) -> None:
    np.testing.assert_allclose(
        (first @ second).apply(point), first.apply(second.apply(point)), atol=1e-9
    )
    np.testing.assert_allclose(first.inverse().apply(first.apply(point)), point, atol=1e-9)


@given(poses())
def test_quaternion_comes_back(pose: Pose) -> None:
    quaternion = pose.quaternion()
    assert quaternion[3] >= 0.0
    again = Pose.from_quaternion(pose.translation, quaternion)
    np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-12)


def test_quaternion_is_x_y_z_w() -> None:
    half = math.radians(30.0) / 2.0
    pose = Pose.from_quaternion([0, 0, 0], [0.0, 0.0, math.sin(half), math.cos(half)])
    np.testing.assert_allclose(pose.rotation, rpy_matrix(0, 0, math.radians(30.0)), atol=1e-12)


def test_a_slightly_long_quaternion_is_normalized() -> None:
    pose = Pose.from_quaternion([0, 0, 0], [0.0, 0.0, 0.0, 1.005])
    np.testing.assert_array_equal(pose.rotation, np.eye(3))


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [0, 0, 0, 1.2], [math.nan, 0, 0, 1]])
def test_what_is_no_rotation_is_refused(quaternion: list[float]) -> None:
    with pytest.raises(ValueError, match="expected 1"):
        Pose.from_quaternion([0, 0, 0], quaternion)


@pytest.mark.parametrize("x", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_refused(x: float) -> None:
    with pytest.raises(ValueError, match="not finite"):
        Pose.from_quaternion([x, 0, 0], [0, 0, 0, 1])


def test_interpolation_is_even_along_the_shortest_arc() -> None:
    before = Pose.from_rpy([0.0, 0.0, 1.0], [0.0, 0.0, math.radians(170.0)])
    after = Pose.from_rpy([4.0, -2.0, 1.0], [0.0, 0.0, math.radians(-170.0)])
    quarter = interpolate(before, after, 0.25)
    np.testing.assert_allclose(quarter.translation, [1.0, -0.5, 1.0])
    np.testing.assert_allclose(quarter.rotation, rpy_matrix(0, 0, math.radians(175.0)), atol=1e-12)


@given(poses(), poses())
def test_interpolation_meets_both_ends(before: Pose, after: Pose) -> None:
    for fraction, end in ((0.0, before), (1.0, after)):
        pose = interpolate(before, after, fraction)
        np.testing.assert_allclose(pose.rotation, end.rotation, atol=1e-6)
        np.testing.assert_allclose(pose.translation, end.translation, atol=1e-9)


def test_a_pose_holds_its_numbers_alone() -> None:
    """Buffers keep thousands of poses."""
    turned = Pose.from_rpy([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    there = Pose.from_quaternion([1.0, 2.0, 3.0], turned.quaternion())
    for pose in (turned, there, interpolate(turned, there, 0.5)):
        assert pose.rotation.base is None
        assert pose.rotation.nbytes == 72
