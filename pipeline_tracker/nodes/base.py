"""What the four nodes have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.subscription import Subscription

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.diagnostics.levels import Level
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.jit import kernels_are_kept
from pipeline_tracker.messages import pose_from_message
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.live_clock import LiveClock
from pipeline_tracker.nodes.mounting import MountingListener, mounting_of_settings
from pipeline_tracker.nodes.parameters import (
    AUTOSTART,
    ParameterGate,
    as_parameters,
    declare_settings,
    read_settings,
)
from pipeline_tracker.nodes.talking import TalkingNode
from pipeline_tracker.nodes.timeline import StampJudge, Timeline
from pipeline_tracker.pipeline import COMPILING, Stage, warm_up
from pipeline_tracker.settings import Settings

_NO_MOUNTING = "waiting for the camera's mounting on /tf_static"


class NotReadyError(PipelineTrackerError):
    """A node that is not at work is asked to do something."""


_POSE_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
}


class PipelineNode(TalkingNode):
    """A managed node whose parameters are the settings.

    Configuring reads and checks the settings and opens the outputs (``open_outputs``); activating
    opens the inputs (``start``); deactivating ends these (``stop``) and forgets the past.
    """

    # What is loaded before its first frame; the other stages have other nodes.
    STAGE: ClassVar[Stage]

    def __init__(self, parameters: Mapping[str, Any] | None = None, **options: Any) -> None:
        """Make the node, unconfigured; no topic is opened yet.

        Args:
            parameters: parameter values that win over those of the command line.
            options: of ``rclpy.node.Node``.
        """
        super().__init__(
            parameter_overrides=as_parameters(parameters or {}),
            automatically_declare_parameters_from_overrides=True,
            **options,
        )
        self.is_ready = False
        self.settings: Settings
        self.live_clock: LiveClock
        declare_settings(self)
        # Kept: rclpy calls it, and does not hold it.
        self._gate = ParameterGate(self)

    @property
    def autostart(self) -> bool:
        """Whether the node is to be configured and activated by its own process."""
        # Anything else than false is for the settings to judge.
        return self.get_parameter(AUTOSTART).value is not False

    def configure(self) -> None:
        """Read and check the settings, compile the kernels and open the outputs.

        Raises:
            PipelineTrackerError: a setting, or the camera's mounting, is missing or impossible.
        """
        self.settings = read_settings(self)
        self._gate.settled = True
        self.scope.add(setattr, self._gate, "settled", False)
        self.live_clock = LiveClock(self._now_ns)
        self.check()
        if not kernels_are_kept():
            self.get_logger().info(COMPILING)
        warm_up(self.STAGE)
        self.open_outputs()

    def activate(self) -> None:
        """Open the inputs; from here on the node answers."""
        # rclpy forgets the callback with the handle.
        jumps = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=self._on_jump,
        )
        self.scope.add(jumps.unregister)
        # Ends when the inputs have ended, and while the outputs are still heard.
        self.scope.add(self._stop)
        self.start()

    def check(self) -> None:
        """Check what the settings' model cannot.

        Raises:
            PipelineTrackerError: something is missing or impossible.
        """

    def open_outputs(self) -> None:
        """Open the topics that this node publishes, and its services."""

    def start(self) -> None:
        """Open the topics that this node subscribes to and report that it is ready."""
        raise NotImplementedError

    def stop(self) -> None:
        """Forget the past; the inputs are closed."""

    def change(self) -> None:
        """Go on with other ``settings``: some of those that may change while the node runs."""

    def change_settings(self, settings: Settings) -> None:
        """Take over settings that have been checked."""
        self.settings = settings
        if self.is_ready:
            self.change()

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget the past, simulated time has gone back by ``way_ns`` to ``now_ns``."""

    def ready(self) -> None:
        """Report that the node answers from now on."""
        self.is_ready = True
        self.get_logger().info("ready")

    def timeline(self, judge: StampJudge | None = None) -> Timeline:
        """Return what notices wrong stamps, and time going backward, for this node.

        Args:
            judge: of its stamps; None: one that takes no age for stale.
        """
        return Timeline(
            self._now_ns if self.settings.use_sim_time else None,
            judge=judge or StampJudge(self.live_clock),
        )

    def listen_to_poses(self, callback: Callable[[int, Pose], None]) -> Subscription:
        """Subscribe to vnm/pose, of the type that the settings say."""
        kind = _POSE_TYPES[self.settings.pose_type]

        def on_pose(given: tuple[int, Pose]) -> None:
            callback(*given)

        return self.listen(kind, "vnm/pose", on_pose, qos.POSE, pose_from_message, Need.WANTED)

    def require_ready(self, what: str) -> None:
        """Check that the node is at work.

        Args:
            what: is asked of it.

        Raises:
            NotReadyError: it is not active, or still waits for the camera's mounting.
        """
        if not self.is_active:
            raise NotReadyError(f"{what}: {self.NAME} is not active; activate it first")
        if not self.is_ready:
            raise NotReadyError(f"{what}: {self.NAME} still waits for the camera's mounting")

    def _stop(self) -> None:
        self.is_ready = False
        self.stop()

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

    def check(self) -> None:
        """Check that there is a mounting, or can be one.

        Raises:
            SettingsError: one half of it is given without the other.
            CalibrationError: there is no mounting, nor can there ever be.
        """
        self._mounting = mounting_of_settings(self.settings)

    def start(self) -> None:
        """Open the topics as soon as the mounting is known."""
        if self._mounting is not None:
            self.start_mounted(self._mounting)
        else:
            self.health.note("mounting", "not known", Level.ERROR, _NO_MOUNTING)
            self._listener = MountingListener(self, self._start_found)

    def _start_found(self, mounting: Pose) -> None:
        self.health.note("mounting", "from /tf_static")
        self.start_mounted(mounting)

    def start_mounted(self, mounting: Pose) -> None:
        """Open the topics; ``mounting`` is base_link <- left optical frame."""
        raise NotImplementedError
