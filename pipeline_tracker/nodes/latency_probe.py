"""A node that publishes a vehicle's input at a rate and times the answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from pipeline_tracker.errors import BenchError
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.messages import (
    camera_info_message,
    header_message,
    pose_stamped_message,
    stamp_ns,
)
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import LiveMessages, message_class
from pipeline_tracker.types import Image

_SIDES = ("left", "right")
_FRAME_ID = "left_optical"
_MATCH_WITHIN = 20.0
# No new subscriber for this long: whoever wants to listen listens, s.
_SETTLED_AFTER = 0.5
# After the last pair: what is under way arrives, s.
_LINGER = 2.0


@dataclass(frozen=True)
class Answer:
    """A relative state: s from the image's stamp to its receipt, and whether it is valid."""

    seconds: float
    valid: bool


@dataclass
class Heard:
    """What was published and what came back.

    Attributes:
        stamps: of the pairs, ns, in order.
        answers: the first relative state of each stamp that came.
    """

    stamps: list[int] = field(default_factory=list)
    answers: dict[int, Answer] = field(default_factory=dict)


class LatencyProbe:
    """Cameras and navigation of a vehicle, and a stopwatch."""

    def __init__(self, rig: StereoRig, domain: int, odom: str) -> None:
        """Open the topics.

        Args:
            rig: two cameras.
            domain: ROS domain of the nodes.
            odom: frame of the poses.
        """
        self._rig = rig
        self._odom = odom
        self._factory = LiveMessages()
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._node = rclpy.create_node("latency_probe", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._images = [
            self._open(f"stereo/{side}/image_rect", "sensor_msgs/msg/Image") for side in _SIDES
        ]
        self._infos = [
            self._open(f"stereo/{side}/camera_info", "sensor_msgs/msg/CameraInfo")
            for side in _SIDES
        ]
        self._poses = self._open("vnm/pose", "geometry_msgs/msg/PoseStamped")
        self._heard = Heard()
        self._states = self._node.create_subscription(
            message_class("pipeline_tracker_msgs/msg/RelativeState"),
            "pipeline/relative_state",
            self._on_state,
            qos.PIPELINE.qos(),
        )

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def wait_for_nodes(self) -> None:
        """Wait until all our topics have subscribers and the answers' topic its publisher.

        Raises:
            BenchError: some have none.
        """
        changed = started = time.monotonic()
        counts: list[int] = []
        ours = (*self._images, *self._infos, self._poses)
        while time.monotonic() - started < _MATCH_WITHIN:
            now = [publisher.get_subscription_count() for publisher in ours]
            now.append(self._node.count_publishers(self._states.topic_name))
            if now != counts:
                counts, changed = now, time.monotonic()
            if min(counts) > 0 and time.monotonic() - changed >= _SETTLED_AFTER:
                return
            self._executor.spin_once(timeout_sec=0.02)
        raise BenchError(
            f"--live: nobody listens to some topics within {_MATCH_WITHIN:g} s; are other settings "
            "of DDS in the environment?"
        )

    def run(
        self,
        pairs: Iterator[tuple[Image, Image, Pose]],
        hertz: float,
        count: int,
        look: Callable[[], None],
    ) -> Heard:
        """Publish pairs on an absolute schedule, each stamped with the time of its publication.

        Args:
            pairs: left and right image, and the pose at their stamp, which is published after them.
            hertz: pairs a second.
            count: how many.
            look: called between pairs.
        """
        self._heard = Heard()
        started = time.monotonic()
        for number in range(count):
            # Copied into a message before its time has come.
            left, right, pose = next(pairs)
            messages = [self._image(left), self._image(right)]
            self._spin_until(started + number / hertz)
            self._publish(messages, pose)
            look()
        deadline = time.monotonic() + _LINGER
        while len(self._heard.answers) < count and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)
        return self._heard

    def _publish(self, messages: list[Any], pose: Pose) -> None:
        stamp = time.time_ns()
        self._heard.stamps.append(stamp)
        header = header_message(self._factory, stamp, _FRAME_ID)
        for message, image, info, camera in zip(
            messages, self._images, self._infos, self._rig.cameras, strict=True
        ):
            message.header = header
            info.publish(camera_info_message(self._factory, camera, stamp, _FRAME_ID))
            image.publish(message)
        self._poses.publish(pose_stamped_message(self._factory, pose, stamp, self._odom))

    def _image(self, pixels: Image) -> Any:
        height, width = pixels.shape
        return self._factory.message(
            "sensor_msgs/msg/Image",
            height=height,
            width=width,
            step=width,
            encoding="mono8",
            data=self._factory.sequence(pixels.ravel()),
        )

    def _spin_until(self, due: float) -> None:
        while (left := due - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def _on_state(self, message: Any) -> None:
        now = time.time_ns()
        stamp = stamp_ns(message.header)
        # A state of the silence before the first pair is no answer.
        if stamp in self._heard.stamps[-100:]:
            answer = Answer((now - stamp) / SECOND_NS, bool(message.valid))
            self._heard.answers.setdefault(stamp, answer)

    def _open(self, topic: str, type_name: str) -> Any:
        profile = qos.POSE if topic == "vnm/pose" else qos.SENSOR
        return self._node.create_publisher(message_class(type_name), topic, profile.qos())
