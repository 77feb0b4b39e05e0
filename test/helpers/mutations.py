"""Sound messages of every type that is read, and mutated copies of them, in either world."""

from __future__ import annotations

import copy
import math
import random
from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from pipeline_tracker import messages
from pipeline_tracker.camera_info import camera_from_info, raw_camera_from_info
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.images import decode_image
from pipeline_tracker.settings import ImageSettings
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
from pipeline_tracker.validation.fields import field_names

STAMP = 1_700_000_000_123_456_789
LEFT = Camera(120.0, 120.0, 79.5, 59.5, 160, 120)
RIG = StereoRig(LEFT, replace(LEFT, offset=0.2))

FLOATS = (math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e9, 1e38, -1e300, 0.5, 2.0)
TEXTS = ("", "x", "bayer_rggb8", "mono16", "32FC1", "nan", "é" * 3000)
# What fits an unsigned byte, and what a wider integer has beside it.
BYTES = (0, 1, 2, 3, 4, 7, 15, 16, 127, 255)
WIDE = (160, 120, 999_999_999, 1_000_000_000, 2**31 - 1)
WIDE_NAMES = ("sec", "nanosec", "width", "height", "step", "reset_counter", "x_offset", "y_offset")


def header(factory: Any) -> Any:
    return messages.header_message(factory, STAMP, "left_optical")


def image(factory: Any) -> Any:
    pixels = np.random.default_rng(0).integers(0, 256, (LEFT.height, LEFT.width), np.uint8)
    return factory.message(
        "sensor_msgs/msg/Image",
        header=header(factory),
        height=LEFT.height,
        width=LEFT.width,
        step=LEFT.width,
        encoding="mono8",
        data=factory.sequence(pixels.ravel()),
    )


def compressed(factory: Any) -> Any:
    pixels = np.full((LEFT.height, LEFT.width), 90, np.uint8)
    packed = np.asarray(cv2.imencode(".jpg", pixels)[1], np.uint8).ravel()
    kind = "sensor_msgs/msg/CompressedImage"
    return factory.message(
        kind, header=header(factory), format="jpeg", data=factory.sequence(packed)
    )


def camera_info(factory: Any) -> Any:
    return messages.camera_info_message(factory, RIG.right, STAMP, "left_optical")


def pose(factory: Any) -> Any:
    placed = Pose.from_rpy([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    return messages.pose_stamped_message(factory, placed, STAMP, "odom")


def pose_with_covariance(
    factory: Any, kind: str = "geometry_msgs/msg/PoseWithCovarianceStamped"
) -> Any:
    inner = factory.message(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=pose(factory).pose,
        covariance=np.diag([0.1, 0.1, 0.2, 1e-3, 1e-3, 1e-2]).ravel(),
    )
    return factory.message(kind, header=header(factory), pose=inner)


def odometry(factory: Any) -> Any:
    return pose_with_covariance(factory, "nav_msgs/msg/Odometry")


def transform(factory: Any) -> Any:
    x, y, z, w = Pose.from_rpy([0.0] * 3, [0.1, 0.2, 0.3]).quaternion()
    return factory.message(
        "geometry_msgs/msg/TransformStamped",
        header=header(factory),
        child_frame_id="left_optical",
        transform=factory.message(
            "geometry_msgs/msg/Transform",
            translation=factory.message("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=0.3),
            rotation=factory.message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )


def ping(factory: Any) -> Any:
    return factory.message(
        "sensor_msgs/msg/Range",
        header=header(factory),
        field_of_view=0.2,
        min_range=0.5,
        max_range=20.0,
        range=2.0,
    )


def vectorized(factory: Any) -> Any:
    rng = np.random.default_rng(1)
    corners = np.array([LEFT.width, LEFT.height] * 2, np.float32)
    thumbnail = np.full((LEFT.height // 8, LEFT.width // 8), 80, np.uint8)
    left, right, matched = ((rng.random((n, 4)) * corners).astype(np.float32) for n in (30, 28, 60))
    # On a bed 2.3 m below, so that there is something to triangulate.
    matched[:, 2] = matched[:, 0] - LEFT.fx * 0.2 / 2.3
    matched[:, 3] = matched[:, 1]
    frame = VectorizedStereo(STAMP, RIG, left, right, matched, thumbnail, thumbnail, 0.25)
    return messages.vectorized_message(factory, frame, "left_optical")


def segment(factory: Any) -> Any:
    made = PipeSegment(
        stamp_ns=STAMP,
        mode=Mode.TRACKING,
        technique=0,
        start=np.array([0.1, 0.2, -2.0]),
        end=np.array([0.6, 0.2, -2.0]),
        radius=0.3,
        covariance=np.diag([1e-4, 4e-4, 1e-5, 2e-5]),
        support=0.7,
        visible_contours=Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_LEFT,
        contours=np.array([[10, 0, 12, 119], [8, 0, 9, 119]], np.float32),
    )
    return messages.segment_message(factory, made, "base_link")


def status(factory: Any) -> Any:
    made = TrackingStatus(STAMP, State.TRACKING, "", 0.7, 0.0, 1, 0.02)
    return messages.status_message(factory, made, "base_link")


def relative_state(factory: Any) -> Any:
    made = RelativeState(
        STAMP,
        True,
        0.5,
        1,
        heading_misalignment=0.1,
        min_distance=1.7,
        side=Side.ALONG,
        heading_variance=1e-4,
    )
    return messages.relative_state_message(factory, made, "base_link")


# Every sort of message that is read: a sound one by a factory, and what our code makes of it.
KINDS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "image": (image, lambda message: decode_image(message, ImageSettings())),
    "compressed": (compressed, lambda message: decode_image(message, ImageSettings())),
    "camera_info": (camera_info, camera_from_info),
    "raw_camera_info": (camera_info, raw_camera_from_info),
    "pose": (pose, messages.pose_from_message),
    "pose_with_covariance": (pose_with_covariance, messages.pose_from_message),
    "odometry": (odometry, messages.pose_from_message),
    "transform": (transform, messages.transform_from_message),
    "range": (ping, messages.range_from_message),
    "vectorized": (vectorized, messages.vectorized_from_message),
    "segment": (segment, messages.segment_from_message),
    "status": (status, messages.status_from_message),
    "relative_state": (relative_state, messages.relative_state_from_message),
    "request": (header, messages.request_from_message),
}


def mutated(message: Any, rng: random.Random) -> tuple[Any, str]:
    """Return a copy with one to three fields changed, and which."""
    message = copy.deepcopy(message)
    leaves = list(_leaves(message, ""))
    changed = []
    for holder, name, path in rng.sample(leaves, min(rng.choice((1, 1, 1, 2, 3)), len(leaves))):
        changed.append(path)
        _change(holder, name, rng)
    return message, ", ".join(changed)


def _leaves(message: Any, path: str) -> Iterator[tuple[Any, str, str]]:
    for name in field_names(message):
        value = getattr(message, name)
        if field_names(value):
            yield from _leaves(value, f"{path}{name}.")
        else:
            yield message, name, f"{path}{name}"


def _change(holder: Any, name: str, rng: random.Random) -> None:
    value = getattr(holder, name)
    if isinstance(value, bool):
        new: Any = not value
    elif isinstance(value, float):
        new = _fitting_float(holder, name, rng)
    elif isinstance(value, int):
        numbers = (*BYTES, *WIDE, -1) if name == "sec" else BYTES
        new = rng.choice((*numbers, *WIDE) if name in WIDE_NAMES else numbers)
    elif isinstance(value, str):
        new = rng.choice(TEXTS)
    else:
        new = _changed_array(value, rng)
    setattr(holder, name, new)


def _fitting_float(holder: Any, name: str, rng: random.Random) -> float:
    value = rng.choice(FLOATS)
    kinds = getattr(holder, "get_fields_and_field_types", dict)()
    # rclpy takes no number that float32 has not.
    if kinds.get(name) == "float" and math.isfinite(value) and abs(value) > 3e38:
        return math.copysign(3e38, value)
    return value


def _changed_array(value: Any, rng: random.Random) -> Any:
    """Change elements, or the length where that is free (an ``array.array``, or rosbags')."""
    numbers = np.array(value)
    fixed = isinstance(value, np.ndarray) and value.size in {9, 12, 16, 36}
    if len(numbers) and (fixed or rng.random() < 0.6):
        for _ in range(rng.choice((1, 1, 3, 50))):
            place = rng.randrange(len(numbers))
            if numbers.dtype.kind == "f":
                with np.errstate(over="ignore"):
                    numbers[place] = rng.choice(FLOATS)
            else:
                numbers[place] = rng.randrange(256)
    elif rng.random() < 0.5:
        numbers = numbers[: rng.randrange(len(numbers) + 1)]
    else:
        numbers = np.concatenate((numbers, numbers[: rng.randrange(1, 9)]))
    if isinstance(value, np.ndarray):
        return numbers
    return array(value.typecode, numbers.tobytes()) if hasattr(value, "typecode") else numbers
