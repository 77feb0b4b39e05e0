"""Conversions between core types and messages, through CDR and back."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from pipeline_tracker import messages
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.camera_info import camera_from_info
from pipeline_tracker.errors import CalibrationError, MessageError
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.markers import Centerline, markers_message
from pipeline_tracker.types import (
    Contours,
    Mode,
    PipeSegment,
    RelativeState,
    Side,
    State,
    TrackingStatus,
    VectorizedStereo,
)

STAMP = 1_710_000_000_123_456_789


@pytest.fixture(scope="module")
def factory() -> BagMessages:
    return BagMessages()


def through_cdr(factory: BagMessages, message: Any) -> Any:
    raw = factory.serialize(message)
    return factory.store.deserialize_cdr(raw, message.__msgtype__)


def same(one: Any, other: Any) -> None:
    """Compare dataclasses field by field, arrays by value, shape and dtype."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, field.name
            np.testing.assert_array_equal(a, b, err_msg=field.name)
        elif dataclasses.is_dataclass(a):
            same(a, b)
        else:
            assert a == b, field.name


def segment(**changes: Any) -> PipeSegment:
    values: dict[str, Any] = {
        "stamp_ns": STAMP,
        "mode": Mode.TRACKING,
        "technique": 0,
        "start": np.array([0.1, -0.2, -2.0]),
        "end": np.array([0.6, -0.25, -2.02]),
        "radius": 0.3,
        "covariance": np.diag([1.0, 2.0, 3.0, 4.0]) / 7.0 + 0.05,
        "support": float(np.float32(0.7)),
        "visible_contours": Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_RIGHT,
        "contours": np.arange(8, dtype=np.float32).reshape(2, 4),
    }
    return PipeSegment(**{**values, **changes})


def state(**changes: Any) -> RelativeState:
    values: dict[str, Any] = {
        "stamp_ns": STAMP,
        "valid": True,
        "quality": 0.5,
        "reset_counter": 3,
        "heading_misalignment": 0.1,
        "pitch_misalignment": -0.02,
        "min_distance": 1.9,
        "min_distance_base": 1.8,
        "approach_speed": 0.01,
        "lateral_offset": 0.3,
        "vertical_offset": 2.1,
        "side": Side.LEFT_OF_PIPE,
        "motion_observed": True,
        "upper_point": np.array([0.3, 0.0, -1.7]),
        "upper_point_vertical": np.array([0.31, 0.0, -1.69]),
        "chainage": 12.5,
        "heading_variance": 1e-4,
        "pitch_variance": 2e-4,
        "distance_variance": 3e-4,
        "speed_variance": 4e-4,
    }
    return RelativeState(**{**values, **changes})


def test_segment_comes_back(factory: BagMessages) -> None:
    message = messages.segment_message(factory, segment(), "base_link")
    read = through_cdr(factory, message)
    assert read.header.frame_id == "base_link"
    same(messages.segment_from_message(read), segment())


def test_no_segment_comes_back(factory: BagMessages) -> None:
    none = PipeSegment.none(STAMP, 0.3)
    read = through_cdr(factory, messages.segment_message(factory, none, "base_link"))
    same(messages.segment_from_message(read), none)


def test_status_comes_back(factory: BagMessages) -> None:
    status = TrackingStatus(STAMP, State.COASTING, "too dark — no edges", 0.25, 1.5, 2, 0.5)
    read = through_cdr(factory, messages.status_message(factory, status, "base_link"))
    same(messages.status_from_message(read), status)


def test_relative_state_comes_back(factory: BagMessages) -> None:
    read = through_cdr(factory, messages.relative_state_message(factory, state(), "base_link"))
    same(messages.relative_state_from_message(read), state())


@pytest.mark.parametrize("mono", [False, True])
def test_vectorized_comes_back(factory: BagMessages, mono: bool) -> None:
    left = Camera(933.2, 933.2, 599.5, 399.5, 1200, 800)
    right = None if mono else dataclasses.replace(left, offset=0.25)
    rng = np.random.default_rng(1)
    nothing = np.zeros((0, 4), np.float32)
    frame = VectorizedStereo(
        stamp_ns=STAMP,
        rig=StereoRig(left, right),
        left_segments=rng.random((5, 4), np.float32) * 1200,
        right_segments=nothing if mono else rng.random((3, 4), np.float32) * 1200,
        matches=nothing if mono else rng.random((7, 4), np.float32),
        left_thumbnail=rng.integers(0, 255, (100, 150), np.uint8),
        right_thumbnail=np.zeros((0, 0) if mono else (100, 150), np.uint8),
        processing_time=0.25,
    )
    message = messages.vectorized_message(factory, frame, "left_optical")
    read = through_cdr(factory, message)
    assert (read.right_info.width == 0) is mono
    same(messages.vectorized_from_message(read), frame)


def test_given_camera_infos_are_passed_on(factory: BagMessages) -> None:
    camera = Camera(500.0, 500.0, 320.0, 240.0, 640, 480)
    info = messages.camera_info_message(factory, camera, STAMP, "cam")
    info.d = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    empty = np.zeros((0, 4), np.float32)
    thumbnail = np.zeros((60, 80), np.uint8)
    none = np.zeros((0, 0), np.uint8)
    frame = VectorizedStereo(STAMP, StereoRig(camera), empty, empty, empty, thumbnail, none)
    message = messages.vectorized_message(factory, frame, "cam", info, info)
    np.testing.assert_array_equal(through_cdr(factory, message).left_info.d, info.d)
    assert message.right_info.width == 0, "mono: no right camera, whatever came with the images"


def test_camera_info_with_a_short_matrix_is_refused() -> None:
    class Info:
        p = (1.0, 2.0)
        width, height = 640, 480

    with pytest.raises(CalibrationError, match=r"left: P has 2 numbers, expected 12"):
        camera_from_info(Info(), name="left")


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "Odometry"])
def test_each_pose_type_is_read(factory: BagMessages, kind: str) -> None:
    pose = Pose.from_rpy([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    header = messages.header_message(factory, STAMP, "odom")
    inner = messages.pose_message(factory, pose)
    if kind == "PoseStamped":
        message = factory.message("geometry_msgs/msg/PoseStamped", header=header, pose=inner)
    else:
        name = "nav_msgs/msg/Odometry" if kind == "Odometry" else f"geometry_msgs/msg/{kind}"
        outer = factory.message("geometry_msgs/msg/PoseWithCovariance", pose=inner)
        message = factory.message(name, header=header, pose=outer)
    stamp, read = messages.pose_from_message(through_cdr(factory, message))
    assert stamp == STAMP
    np.testing.assert_allclose(read.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(read.translation, pose.translation)


def test_pose_with_a_zero_quaternion_is_refused(factory: BagMessages) -> None:
    message = factory.message("geometry_msgs/msg/PoseStamped")
    message.pose.orientation.w = 0.0
    with pytest.raises(MessageError, match="norm 0"):
        messages.pose_from_message(message)


def test_centerline_spacing_length_and_reset() -> None:
    line = Centerline(spacing=0.5, length=3)
    poses = [Pose(np.eye(3), np.array([0.3 * i, 0.0, 0.0])) for i in range(10)]
    added = [line.update(state(), segment(), pose) for pose in poses]
    assert added == [i % 2 == 0 for i in range(10)], "every second one lies 0.6 m further"
    factory = BagMessages()
    path = line.message(factory, STAMP, "odom")
    assert [round(p.pose.position.x, 6) for p in path.poses] == [1.55, 2.15, 2.75]
    assert path.header.frame_id == "odom"
    line.update(state(), segment(), Pose(np.eye(3), np.array([10.0, 0.0, 0.0])))
    path = line.message(factory, STAMP, "odom")
    assert [round(p.pose.position.x, 6) for p in path.poses] == [2.15, 2.75, 10.35]
    same_for_another = line.message(BagMessages(), STAMP, "odom")
    assert [round(p.pose.position.x, 6) for p in same_for_another.poses] == [2.15, 2.75, 10.35]
    assert not line.update(state(valid=False), segment(), poses[0])
    assert not line.update(state(), segment(), None)
    assert line.update(state(reset_counter=4), segment(), poses[0])
    assert len(line.message(factory, STAMP, "odom").poses) == 1


def test_centerline_pose_points_along_the_pipe(factory: BagMessages) -> None:
    line = Centerline()
    turned = Pose.from_rpy([0.0, 0.0, 0.0], [0.1, -0.2, 2.0])
    line.update(state(), segment(), turned)
    path = through_cdr(factory, line.message(factory, STAMP, "odom"))
    q = path.poses[0].pose.orientation
    x_axis = Pose.from_quaternion([0, 0, 0], [q.x, q.y, q.z, q.w]).rotation[:, 0]
    direction = turned.rotate(segment().end - segment().start)
    np.testing.assert_allclose(x_axis, direction / np.linalg.norm(direction), atol=1e-9)


def test_markers_show_the_cylinder(factory: BagMessages) -> None:
    status = TrackingStatus(STAMP, State.TRACKING, "", 0.7, 0.0, 0)
    array = through_cdr(factory, markers_message(factory, status, segment(), state(), "base_link"))
    cylinder, arrow, top = array.markers
    assert (cylinder.type, arrow.type, top.type) == (3, 0, 2)
    assert cylinder.scale.x == pytest.approx(0.6)
    length = float(np.linalg.norm(segment().end - segment().start))
    assert cylinder.scale.z == pytest.approx(length)
    q = cylinder.pose.orientation
    axis = Pose.from_quaternion([0, 0, 0], [q.x, q.y, q.z, q.w]).rotation
    assert math.isclose(float(np.linalg.det(axis)), 1.0, rel_tol=1e-9)
    along = (segment().end - segment().start) / length
    np.testing.assert_allclose(axis[:, 2], along, atol=1e-9)
    assert arrow.points[1].x == segment().end[0]


def test_markers_are_deleted_without_a_pipe(factory: BagMessages) -> None:
    status = TrackingStatus(STAMP, State.SEARCHING, "no edges", 0.0, -1.0, 0)
    array = markers_message(factory, status, None, state(valid=False), "base_link")
    assert [m.action for m in array.markers] == [3]


def ping(factory: BagMessages, **fields: Any) -> Any:
    values = {"range": 2.0, "min_range": 0.2, "max_range": 20.0, "field_of_view": 0.2, **fields}
    header = messages.header_message(factory, STAMP, "altimeter")
    return factory.message("sensor_msgs/msg/Range", header=header, **values)


def test_a_range_is_read(factory: BagMessages) -> None:
    stamp, distance, half_angle, sigma = messages.range_from_message(ping(factory, variance=0.0025))
    assert (stamp, distance) == (STAMP, 2.0)
    assert half_angle == pytest.approx(0.1)
    assert sigma == pytest.approx(0.05)
    assert messages.range_from_message(ping(factory))[3] == 0.0


@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_what_is_no_echo_is_none(factory: BagMessages, value: float) -> None:
    assert messages.range_from_message(ping(factory, range=value))[1] is None
