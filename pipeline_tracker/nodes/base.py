"""What the four nodes have in common."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from rclpy.clock import Clock, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import LiveMessages, message_class
from pipeline_tracker.nodes.live_clock import LiveClock
from pipeline_tracker.nodes.mounting import MountingListener, mounting_of_settings
from pipeline_tracker.nodes.parameters import as_parameters, declare_settings
from pipeline_tracker.nodes.timeline import Timeline
from pipeline_tracker.settings import Settings

# One warning of each kind in this time, s.
WARN_EVERY = 5.0

_POSE_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
}


class PipelineNode(Node):
    """A node whose parameters are the settings.

    It is made, configured (settings are read and checked) and activated (topics are opened);
    ``close`` ends its threads. A subclass opens its topics in ``start``.
    """

    NAME: ClassVar[str]

    def __init__(self, parameters: Mapping[str, Any] | None = None, **options: Any) -> None:
        """Make the node; no topic is opened yet.

        Args:
            parameters: parameter values that win over those of the command line.
            options: of ``rclpy.node.Node``.
        """
        super().__init__(
            self.NAME,
            parameter_overrides=as_parameters(parameters or {}),
            automatically_declare_parameters_from_overrides=True,
            **options,
        )
        self.messages = LiveMessages()
        self.drops: Counter[str] = Counter()
        self._warned: dict[str, float] = {}
        self.settings: Settings
        self.live_clock: LiveClock

    def configure(self) -> None:
        """Read and check the settings.

        Raises:
            PipelineTrackerError: a setting, or the camera's mounting, is missing or impossible.
        """
        self.settings = declare_settings(self)
        self.live_clock = LiveClock(self._now_ns)

    def activate(self) -> None:
        """Open the topics; from here on the node answers."""
        # rclpy forgets the callback with the handle.
        self._jump_handle = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=self._on_jump,
        )
        self.start()

    def start(self) -> None:
        """Open the topics of this node and report that it is ready."""
        raise NotImplementedError

    def close(self) -> None:
        """End what the node has running beside ROS's callbacks."""

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget the past, simulated time has gone back by ``way_ns`` to ``now_ns``."""

    def ready(self) -> None:
        """Report that the node answers from now on."""
        self.get_logger().info("ready")

    def timeline(self) -> Timeline:
        """Return what notices time going backward for this node."""
        return Timeline(self._now_ns if self.settings.use_sim_time else None)

    def dropped(self, reason: str, details: str = "") -> None:
        """Count an input that is not used, and warn once in a while for each reason."""
        self.drops[reason] += 1
        now = time.monotonic()
        if now - self._warned.get(reason, -WARN_EVERY) < WARN_EVERY:
            return
        self._warned[reason] = now
        words = f"{reason}: {details}" if details else reason
        self.get_logger().warning(f"{words} ({self.drops[reason]} so far)")

    def listen(
        self, type_name: str, topic: str, callback: Callable[[Any], None], profile: qos.Profile
    ) -> Subscription:
        """Subscribe to a topic; a message that cannot be used is counted and never ends the node.

        Args:
            type_name: ``package/msg/Name``.
            topic: relative name.
            callback: called with each message.
            profile: the topic's quality of service.
        """

        def guarded(message: Any) -> None:
            try:
                callback(message)
            except Exception as error:  # noqa: BLE001 - whatever a message does, the node lives on
                self.refused(topic, error)

        return self.create_subscription(
            message_class(type_name),
            topic,
            guarded,
            profile.qos(),
            qos_overriding_options=qos.overriding_options(),
        )

    def listen_to_poses(self, callback: Callable[[Any], None]) -> Subscription:
        """Subscribe to vnm/pose, of the type that the settings say."""
        return self.listen(_POSE_TYPES[self.settings.pose_type], "vnm/pose", callback, qos.POSE)

    def speak(self, type_name: str, topic: str) -> Publisher:
        """Return a publisher of one of our topics."""
        return self.create_publisher(
            message_class(type_name),
            topic,
            qos.PIPELINE.qos(),
            qos_overriding_options=qos.overriding_options(),
        )

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call something at intervals of the steady clock, which runs when simulated time stops."""

        def guarded() -> None:
            try:
                callback()
            except Exception as error:  # noqa: BLE001 - nothing may end the node
                self.refused("timer", error)

        return self.create_timer(seconds, guarded, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def refused(self, what: str, error: Exception) -> None:
        """Count and report a message, or a step of ours, that failed."""
        expected = isinstance(error, PipelineTrackerError | ValueError)
        kind = "" if expected else f"{type(error).__name__}: "
        text = " ".join(f"{kind}{error}".split())
        self.dropped(f"{what} refused" if expected else f"{what} failed", text[:300])

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_jump(self, jump: TimeJump) -> None:
        way = -int(jump.delta.nanoseconds)
        if way <= 0:
            return
        try:
            self.on_clock_went_back(self._now_ns(), way)
        except Exception as error:  # noqa: BLE001 - an error in a jump callback is lost in rclpy
            self.refused("clock", error)


class MountedNode(PipelineNode):
    """A node that needs the camera's mounting: from the settings, else from /tf_static."""

    def configure(self) -> None:
        """Read and check the settings.

        Raises:
            CalibrationError: there is no mounting, nor can there ever be.
            SettingsError: see ``PipelineNode.configure``.
        """
        super().configure()
        self._mounting = mounting_of_settings(self.settings)

    def start(self) -> None:
        """Open the topics as soon as the mounting is known."""
        if self._mounting is not None:
            self.start_mounted(self._mounting)
        else:
            self._listener = MountingListener(self, self.start_mounted)

    def start_mounted(self, mounting: Pose) -> None:
        """Open the topics; ``mounting`` is base_link <- left optical frame."""
        raise NotImplementedError
