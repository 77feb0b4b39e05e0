"""A small sea with truth, and replays of it, written without the pipeline."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer

from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.messages import (
    camera_info_message,
    header_message,
    point_message,
    pose_message,
    relative_state_message,
    segment_message,
    vectorized_message,
)
from pipeline_tracker.mounting import mounting_as_settings
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.replay.estimates import COLUMNS, estimate_row
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import Mode, PipeSegment, State, TrackingStatus, VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import thumbnail

Array = NDArray[np.float64]

SECOND = 1_000_000_000
RADIUS = 0.3
MOUNTING = Pose.from_rpy([0.4, 0.1, -0.2], [-math.pi + 0.4, 0.0, -math.pi / 2.0])
LEFT = Camera(200.0, 200.0, 79.5, 63.5, 160, 128)
RIGHT = replace(LEFT, offset=0.2)
SETTINGS = Settings.model_validate({"pipe": {"diameter": 2.0 * RADIUS}})
COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-4])


@dataclass(frozen=True)
class Frame:
    """What a replay says of a frame; changed by tests."""

    stamp_ns: int
    pose: Pose
    segment: PipeSegment | None
    state: State = State.TRACKING
    has_pose: bool = True
    reset_counter: int = 0

    def moved(self, offset: Array) -> Frame:
        """The segment moved in world by an offset (3,), m."""
        assert self.segment is not None
        aside = self.pose.rotation.T @ offset
        start, end = self.segment.start + aside, self.segment.end + aside
        return replace(self, segment=replace(self.segment, start=start, end=end))


class Sea:
    """A bent pipe, a vehicle that follows it, and what both leave in bags."""

    def __init__(self, count: int = 12, start_ns: int = 1_700_000_000 * SECOND) -> None:
        self.stamps = [start_ns + i * SECOND // 2 for i in range(count)]
        self.poses = [
            Pose.from_rpy(
                [0.25 * i, 0.5 + 0.04 * i, 2.5 + 0.02 * i],
                [0.03 * math.sin(i), 0.04 * math.cos(i), 0.05 + 0.01 * i],
            )
            for i in range(count)
        ]
        x = np.arange(-2.0, 8.0, 0.05)
        self.centerline: Array = np.stack((x, 0.01 * x**2, 0.1 * x + 0.2), axis=1)
        self.contours: list[tuple[Array, Array]] | None = None
        self.images: list[NDArray[np.uint8]] | None = None
        # None: the VNM is without error.
        self.vnm: list[Pose] | None = None
        self.cameras = (LEFT, RIGHT)
        self.mounting = MOUNTING
        self.scenario: str | None = None
        self.messages = BagMessages()

    def frames(self) -> list[Frame]:
        """Estimates made from the truth: both ends on vertices of the true axis."""
        frames = []
        for i, (stamp, pose) in enumerate(zip(self.stamps, self.poses, strict=True)):
            nearest = np.argmin(np.linalg.norm(self.centerline - pose.translation, axis=1)) + 14
            start, end = pose.inverse().apply(self.centerline[[nearest - 5, nearest + 5]])
            mode = Mode.TRACKING if i else Mode.RECOGNITION
            technique = 0 if i else 2
            segment = PipeSegment(
                stamp, mode, technique, start, end, RADIUS, COVARIANCE, support=0.9
            )
            frames.append(Frame(stamp, pose, segment))
        return frames

    def write_truth(self, path: Path, *, leave_out: tuple[str, ...] = ()) -> Path:
        """Write the bag with the truth, without topics whose names begin so."""
        make = self.messages.message
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            bag = _Bag(writer, self.messages, leave_out)
            bag.write("/tf_static", self.stamps[0], self._transforms())
            if self.scenario is not None:
                text = make("std_msgs/msg/String", data=self.scenario)
                bag.write("/ground_truth/scenario", self.stamps[0], text)
            for i, (stamp, pose) in enumerate(zip(self.stamps, self.poses, strict=True)):
                header = header_message(self.messages, stamp, "world")
                bag.write("/ground_truth/pose", stamp, self._stamped(header, pose))
                bag.write("/vnm/pose", stamp, self._navigation(i))
                points = [self._stamped(header, Pose(np.eye(3), p)) for p in self.centerline]
                bag.write(
                    "/ground_truth/centerline",
                    stamp,
                    make("nav_msgs/msg/Path", header=header, poses=points),
                )
                if self.contours is not None:
                    cloud = contour_cloud(self.messages, stamp, *self.contours[i])
                    bag.write("/ground_truth/contours/left", stamp, cloud)
                for name, camera in zip(("left", "right"), self.cameras, strict=True):
                    info = camera_info_message(self.messages, camera, stamp, f"{name}_optical")
                    bag.write(f"/stereo/{name}/camera_info", stamp, info)
                    image = self._image(stamp, name, i)
                    bag.write(f"/stereo/{name}/image_rect", stamp, image)
        return path

    def write_replay(self, directory: Path, frames: list[Frame], *, result: bool = True) -> Path:
        """Write a replay's directory; relative states as the estimator gives them."""
        directory.mkdir()
        settings = {
            "pipe.diameter": 2.0 * RADIUS,
            "topics.pose": "/vnm/pose",
            "frames.left_optical": "left_optical",
        }
        settings |= mounting_as_settings(MOUNTING)
        (directory / "settings.yaml").write_text(yaml.safe_dump(settings))
        estimator, poses = RelativeStateEstimator(SETTINGS, MOUNTING), PoseBuffer(3.0)
        rows, records = [], []
        for frame in frames:
            if frame.has_pose:
                poses.add(frame.stamp_ns, frame.pose)
            reason = "" if frame.has_pose else "no_pose"
            status = TrackingStatus(
                frame.stamp_ns, frame.state, reason, 0.9, 0.0, frame.reset_counter
            )
            state = estimator.update(status, frame.segment, poses)
            rows.append(
                estimate_row(
                    status, frame.segment, state, has_pose=frame.has_pose, processing_ms=1.0
                )
            )
            records.append((frame, state))
        with (directory / "estimates.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(rows)
        if result:
            with Writer(
                directory / "result", version=9, storage_plugin=StoragePlugin.MCAP
            ) as writer:
                bag = _Bag(writer, self.messages)
                for i, (frame, state) in enumerate(records):
                    self._write_result(bag, i, frame, state)
        return directory

    def _write_result(self, bag: _Bag, index: int, frame: Frame, state: Any) -> None:
        stamp = frame.stamp_ns
        if frame.has_pose:
            bag.write("/vnm/pose", stamp, self._navigation(index))
        if self.images is not None:
            nothing = np.zeros((0, 4), np.float32)
            small = thumbnail(self.images[index])
            rig = StereoRig(LEFT, RIGHT)
            seen = VectorizedStereo(stamp, rig, nothing, nothing, nothing, small, small)
            message = vectorized_message(self.messages, seen, "left_optical")
            bag.write("/pipeline/vectorized", stamp, message)
        if frame.segment is not None:
            message = segment_message(self.messages, frame.segment, "base_link")
            bag.write("/pipeline/segment", stamp, message)
        message = relative_state_message(self.messages, state, "base_link")
        bag.write("/pipeline/relative_state", stamp, message)

    def _navigation(self, index: int) -> Any:
        pose = (self.vnm or self.poses)[index]
        return self._stamped(header_message(self.messages, self.stamps[index], "odom"), pose)

    def _image(self, stamp: int, name: str, index: int) -> Any:
        pixels = np.zeros((128, 160), np.uint8) if self.images is None else self.images[index]
        return self.messages.message(
            "sensor_msgs/msg/Image",
            header=header_message(self.messages, stamp, f"{name}_optical"),
            height=128,
            width=160,
            encoding="mono8",
            step=160,
            data=pixels.ravel(),
        )

    def _transforms(self) -> Any:
        make, pose = self.messages.message, pose_message(self.messages, self.mounting)
        place = pose.position
        transform = make(
            "geometry_msgs/msg/TransformStamped",
            header=header_message(self.messages, self.stamps[0], "base_link"),
            child_frame_id="left_optical",
            transform=make(
                "geometry_msgs/msg/Transform",
                translation=make("geometry_msgs/msg/Vector3", x=place.x, y=place.y, z=place.z),
                rotation=pose.orientation,
            ),
        )
        return make("tf2_msgs/msg/TFMessage", transforms=[transform])

    def _stamped(self, header: Any, pose: Pose) -> Any:
        make = self.messages.message
        turn = make("geometry_msgs/msg/Quaternion", w=1.0)
        # Points of a path need no rotation worked out.
        flat = np.array_equal(pose.rotation, np.eye(3))
        place = point_message(self.messages, pose.translation)
        given = (
            make("geometry_msgs/msg/Pose", position=place, orientation=turn)
            if flat
            else pose_message(self.messages, pose)
        )
        return make("geometry_msgs/msg/PoseStamped", header=header, pose=given)


class _Bag:
    """Writes messages, and makes connections as they are needed."""

    def __init__(
        self, writer: Writer, messages: BagMessages, leave_out: tuple[str, ...] = ()
    ) -> None:
        self._writer = writer
        self._leave_out = leave_out
        self._messages = messages
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, stamp: int, message: Any) -> None:
        if topic.startswith(self._leave_out):
            return
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self._messages.store
            )
        raw = self._messages.serialize(message)
        self._writer.write(self._connections[topic], stamp, raw)


def contour_cloud(messages: BagMessages, stamp: int, pixels: Array, flags: Array) -> Any:
    """A PointCloud2 of contours: pixels (2, S, 2), flags (2, S)."""
    names = ("x", "y", "z", "u", "v", "s", "flag")
    data = np.zeros((*flags.shape, len(names)), np.float32)
    data[..., 3:5], data[..., 6] = pixels, flags
    fields = [
        messages.message("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate(names)
    ]
    return messages.message(
        "sensor_msgs/msg/PointCloud2",
        header=header_message(messages, stamp, "left_optical"),
        height=flags.shape[0],
        width=flags.shape[1],
        fields=fields,
        point_step=28,
        row_step=28 * flags.shape[1],
        data=np.frombuffer(data.tobytes(), np.uint8),
    )


@pytest.fixture
def sea() -> Sea:
    return Sea()


@pytest.fixture
def make_sea() -> Callable[..., Sea]:
    """The class, for tests that need another sea (test files cannot import this one)."""
    return Sea
