"""Core types to and from ROS messages, without ROS.

Offline commands write messages with rosbags' classes, live nodes with rclpy's. Both sets of classes
have the same fields, so that the conversions are written once, here, over a small factory:

    class MessageFactory(Protocol):
        def message(self, type_name, **fields): ...     # fields left out take their defaults
        def sequence(self, values): ...                 # a NumPy array as an unbounded sequence

A node's factory looks the class up and takes rclpy's keyword constructor; ``sequence`` gives an
``array.array`` (``array.array("f", values.tobytes())``), which rclpy assigns without looking at
each element. Fixed-size fields (``float64[16]``) are float64 arrays for both. Reading needs no
factory: fields are fields, and NumPy takes an ``array.array`` without a copy of each element.

float32 of a message is float32 in the core too, so that nothing is lost on the way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.camera_info import camera_from_info
from pipeline_tracker.geometry.camera import Camera, StereoRig, stereo_rig
from pipeline_tracker.geometry.pose import Pose
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
from pipeline_tracker.validation.fields import check_stamp
from pipeline_tracker.validation.inputs import check_pose, check_range, check_transform
from pipeline_tracker.validation.ours import (
    check_relative_state,
    check_segment,
    check_status,
    check_vectorized,
)

Array = NDArray[np.float64]

_SECOND = 1_000_000_000


class MessageFactory(Protocol):
    """Makes messages of one of the two worlds (rosbags, rclpy)."""

    def message(self, type_name: str, /, **fields: Any) -> Any:
        """Return a message of ``package/msg/Name``; fields left out have their defaults."""

    def sequence(self, values: NDArray[Any], /) -> Any:
        """Return a one-dimensional array as the value of an unbounded sequence field."""


def stamp_ns(header: Any) -> int:
    """Return the stamp of a std_msgs/Header in ns."""
    return int(header.stamp.sec) * _SECOND + int(header.stamp.nanosec)


def time_message(factory: MessageFactory, nanoseconds: int) -> Any:
    """Return builtin_interfaces/Time of a stamp in ns."""
    sec, nanosec = divmod(int(nanoseconds), _SECOND)
    return factory.message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def header_message(factory: MessageFactory, nanoseconds: int, frame_id: str) -> Any:
    """Return std_msgs/Header of a stamp in ns; a recognition request is nothing but this."""
    return factory.message(
        "std_msgs/msg/Header", stamp=time_message(factory, nanoseconds), frame_id=frame_id
    )


def point_message(factory: MessageFactory, point: Array) -> Any:
    """Return geometry_msgs/Point of (3,), m."""
    x, y, z = (float(v) for v in point)
    return factory.message("geometry_msgs/msg/Point", x=x, y=y, z=z)


def pose_message(factory: MessageFactory, pose: Pose) -> Any:
    """Return geometry_msgs/Pose."""
    x, y, z, w = (float(v) for v in pose.quaternion())
    return factory.message(
        "geometry_msgs/msg/Pose",
        position=point_message(factory, pose.translation),
        orientation=factory.message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def pose_stamped_message(
    factory: MessageFactory, pose: Pose, nanoseconds: int, frame_id: str
) -> Any:
    """Return geometry_msgs/PoseStamped in the frame ``frame_id``."""
    return factory.message(
        "geometry_msgs/msg/PoseStamped",
        header=header_message(factory, nanoseconds, frame_id),
        pose=pose_message(factory, pose),
    )


def transforms_message(
    factory: MessageFactory, nanoseconds: int, parent: str, children: Mapping[str, Pose]
) -> Any:
    """Return tf2_msgs/TFMessage.

    Args:
        factory: makes the messages.
        nanoseconds: stamp, ns.
        parent: parent frame.
        children: pose parent <- child by the child's frame.
    """
    header = header_message(factory, nanoseconds, parent)
    transforms = []
    for child, pose in children.items():
        placed = pose_message(factory, pose)
        x, y, z = placed.position.x, placed.position.y, placed.position.z
        transform = factory.message(
            "geometry_msgs/msg/Transform",
            translation=factory.message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            rotation=placed.orientation,
        )
        transforms.append(
            factory.message(
                "geometry_msgs/msg/TransformStamped",
                header=header,
                child_frame_id=child,
                transform=transform,
            )
        )
    return factory.message("tf2_msgs/msg/TFMessage", transforms=transforms)


def float_message(factory: MessageFactory, value: float) -> Any:
    """Return std_msgs/Float64."""
    return factory.message("std_msgs/msg/Float64", data=float(value))


def camera_info_message(
    factory: MessageFactory, camera: Camera | None, nanoseconds: int, frame_id: str
) -> Any:
    """Return sensor_msgs/CameraInfo of a rectified camera; width 0 for None (mono)."""
    if camera is None:
        return factory.message(
            "sensor_msgs/msg/CameraInfo", header=header_message(factory, nanoseconds, frame_id)
        )
    p = np.zeros((3, 4))
    p[:, :3] = camera.matrix
    p[0, 3] = -camera.fx * camera.offset
    return factory.message(
        "sensor_msgs/msg/CameraInfo",
        header=header_message(factory, nanoseconds, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=factory.sequence(np.zeros(5)),
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=p.ravel(),
    )


def vectorized_message(
    factory: MessageFactory,
    frame: VectorizedStereo,
    frame_id: str,
    left_info: Any = None,
    right_info: Any = None,
) -> Any:
    """Return pipeline_tracker_msgs/VectorizedStereo.

    Args:
        factory: makes the messages.
        frame: the vectorized pair.
        frame_id: the left optical frame.
        left_info, right_info: the CameraInfo messages that came with the images, passed on as
            they are; None: made from ``frame.rig``.
    """
    rig = frame.rig

    def info(given: Any, camera: Camera | None) -> Any:
        if given is not None and camera is not None:
            return given
        return camera_info_message(factory, camera, frame.stamp_ns, frame_id)

    return factory.message(
        "pipeline_tracker_msgs/msg/VectorizedStereo",
        header=header_message(factory, frame.stamp_ns, frame_id),
        left_info=info(left_info, rig.left),
        right_info=info(right_info, rig.right),
        left_segments=_flat(factory, frame.left_segments, np.float32),
        right_segments=_flat(factory, frame.right_segments, np.float32),
        matches=_flat(factory, frame.matches, np.float32),
        left_thumbnail=_flat(factory, frame.left_thumbnail, np.uint8),
        right_thumbnail=_flat(factory, frame.right_thumbnail, np.uint8),
        processing_time=float(np.float32(frame.processing_time)),
    )


def segment_message(factory: MessageFactory, segment: PipeSegment, base_link: str) -> Any:
    """Return pipeline_tracker_msgs/PipeSegment in the frame ``base_link``."""
    return factory.message(
        "pipeline_tracker_msgs/msg/PipeSegment",
        header=header_message(factory, segment.stamp_ns, base_link),
        mode=int(segment.mode),
        technique=int(segment.technique),
        start=point_message(factory, segment.start),
        end=point_message(factory, segment.end),
        radius=float(segment.radius),
        covariance=np.ascontiguousarray(segment.covariance, dtype=np.float64).reshape(16),
        support=float(np.float32(segment.support)),
        visible_contours=int(segment.visible_contours),
        contours=_flat(factory, segment.contours, np.float32),
    )


def status_message(factory: MessageFactory, status: TrackingStatus, base_link: str) -> Any:
    """Return pipeline_tracker_msgs/TrackingStatus."""
    return factory.message(
        "pipeline_tracker_msgs/msg/TrackingStatus",
        header=header_message(factory, status.stamp_ns, base_link),
        state=int(status.state),
        reason=status.reason,
        support=float(np.float32(status.support)),
        seconds_since_seen=float(status.seconds_since_seen),
        reset_counter=int(status.reset_counter),
        processing_time=float(np.float32(status.processing_time)),
    )


_RELATIVE_STATE_NUMBERS = (
    "heading_misalignment",
    "pitch_misalignment",
    "min_distance",
    "min_distance_base",
    "approach_speed",
    "lateral_offset",
    "vertical_offset",
    "chainage",
    "heading_variance",
    "pitch_variance",
    "distance_variance",
    "speed_variance",
)


def relative_state_message(factory: MessageFactory, state: RelativeState, base_link: str) -> Any:
    """Return pipeline_tracker_msgs/RelativeState in the frame ``base_link``."""
    return factory.message(
        "pipeline_tracker_msgs/msg/RelativeState",
        header=header_message(factory, state.stamp_ns, base_link),
        valid=bool(state.valid),
        quality=float(np.float32(state.quality)),
        reset_counter=int(state.reset_counter),
        side=int(state.side),
        motion_observed=bool(state.motion_observed),
        upper_point=point_message(factory, state.upper_point),
        upper_point_vertical=point_message(factory, state.upper_point_vertical),
        **{name: float(getattr(state, name)) for name in _RELATIVE_STATE_NUMBERS},
    )


def request_from_message(header: Any) -> int:
    """Read the std_msgs/Header of a recognition request: the stamp of the frame, ns.

    Raises:
        MessageError: see ``check_stamp``.
    """
    check_stamp(header, "stamp")
    return stamp_ns(header)


def vectorized_from_message(message: Any) -> VectorizedStereo:
    """Read pipeline_tracker_msgs/VectorizedStereo.

    Raises:
        CalibrationError: a camera info in it is unusable.
        MessageError: see ``check_vectorized``.
    """
    left = camera_from_info(message.left_info, name="left_info")
    right = None
    if int(message.right_info.width) > 0:
        right = camera_from_info(message.right_info, name="right_info")
    rig: StereoRig = stereo_rig(left, right)
    check_vectorized(message)
    shape = (left.height // 8, left.width // 8)
    return VectorizedStereo(
        stamp_ns=stamp_ns(message.header),
        rig=rig,
        left_segments=_rows(message.left_segments),
        right_segments=_rows(message.right_segments),
        matches=_rows(message.matches),
        left_thumbnail=_bytes(message.left_thumbnail).reshape(shape),
        right_thumbnail=_bytes(message.right_thumbnail).reshape(shape if right else (0, 0)),
        processing_time=float(message.processing_time),
    )


def segment_from_message(message: Any) -> PipeSegment:
    """Read pipeline_tracker_msgs/PipeSegment.

    Raises:
        MessageError: see ``check_segment``.
    """
    check_segment(message)
    return PipeSegment(
        stamp_ns=stamp_ns(message.header),
        mode=Mode(int(message.mode)),
        technique=int(message.technique),
        start=_point(message.start),
        end=_point(message.end),
        radius=float(message.radius),
        covariance=np.array(message.covariance, dtype=np.float64).reshape(4, 4),
        support=float(message.support),
        visible_contours=Contours(int(message.visible_contours)),
        contours=_rows(message.contours),
    )


def status_from_message(message: Any) -> TrackingStatus:
    """Read pipeline_tracker_msgs/TrackingStatus.

    Raises:
        MessageError: see ``check_status``.
    """
    check_status(message)
    return TrackingStatus(
        stamp_ns=stamp_ns(message.header),
        state=State(int(message.state)),
        reason=str(message.reason),
        support=float(message.support),
        seconds_since_seen=float(message.seconds_since_seen),
        reset_counter=int(message.reset_counter),
        processing_time=float(message.processing_time),
    )


def relative_state_from_message(message: Any) -> RelativeState:
    """Read pipeline_tracker_msgs/RelativeState.

    Raises:
        MessageError: see ``check_relative_state``.
    """
    check_relative_state(message)
    return RelativeState(
        stamp_ns=stamp_ns(message.header),
        valid=bool(message.valid),
        quality=float(message.quality),
        reset_counter=int(message.reset_counter),
        side=Side(int(message.side)),
        motion_observed=bool(message.motion_observed),
        upper_point=_point(message.upper_point),
        upper_point_vertical=_point(message.upper_point_vertical),
        **{name: float(getattr(message, name)) for name in _RELATIVE_STATE_NUMBERS},
    )


def pose_from_message(message: Any) -> tuple[int, Pose]:
    """Read a VNM pose: PoseStamped, PoseWithCovarianceStamped or Odometry.

    Returns:
        Stamp in ns, and the pose of base_link in odom.

    Raises:
        MessageError: see ``check_pose``.
    """
    check_pose(message)
    pose = message.pose
    # The two types with covariance hold the pose one level deeper.
    pose = getattr(pose, "pose", pose)
    position, quaternion = pose.position, pose.orientation
    return stamp_ns(message.header), Pose.from_quaternion(
        [position.x, position.y, position.z],
        [quaternion.x, quaternion.y, quaternion.z, quaternion.w],
    )


def range_from_message(message: Any) -> tuple[int, float | None, float, float]:
    """Read sensor_msgs/Range.

    Returns:
        Stamp in ns; range in m, None where there was no echo (infinite, by REP 117); half the
        beam's width, rad; standard deviation, m, 0 where the message does not tell it.

    Raises:
        MessageError: see ``check_range``.
    """
    check_range(message)
    distance = float(message.range)
    # Older definitions of the message have no variance.
    sigma = float(np.sqrt(float(getattr(message, "variance", 0.0))))
    half = 0.5 * float(message.field_of_view)
    return stamp_ns(message.header), distance if np.isfinite(distance) else None, half, sigma


def transform_from_message(message: Any) -> tuple[str, str, Pose]:
    """Read geometry_msgs/TransformStamped.

    Returns:
        Parent frame, child frame (without a leading slash), and the pose parent <- child.

    Raises:
        MessageError: see ``check_transform``.
    """
    check_transform(message)
    translation, quaternion = message.transform.translation, message.transform.rotation
    pose = Pose.from_quaternion(
        [translation.x, translation.y, translation.z],
        [quaternion.x, quaternion.y, quaternion.z, quaternion.w],
    )
    parent = str(message.header.frame_id).lstrip("/")
    return parent, str(message.child_frame_id).lstrip("/"), pose


def _flat(factory: MessageFactory, values: NDArray[Any], dtype: Any) -> Any:
    return factory.sequence(np.ascontiguousarray(values, dtype=dtype).ravel())


def _rows(values: Any) -> NDArray[np.float32]:
    return np.array(values, dtype=np.float32).reshape(-1, 4)


def _bytes(values: Any) -> NDArray[np.uint8]:
    if isinstance(values, bytes | bytearray):
        return np.frombuffer(bytes(values), np.uint8)
    return np.array(values, dtype=np.uint8)


def _point(message: Any) -> Array:
    return np.array([message.x, message.y, message.z], dtype=np.float64)
