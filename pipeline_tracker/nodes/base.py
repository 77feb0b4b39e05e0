"""What the four nodes have in common."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

from rclpy.clock import Clock, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from pipeline_tracker.diagnostics.health import ACTIVE, INACTIVE, UNCONFIGURED, Health
from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.diagnostics.levels import Level, Report
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.messages import pose_from_message, stamp_ns
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import LiveMessages, message_class
from pipeline_tracker.nodes.diagnostics import (
    DiagnosticsSpeaker,
    QosWatch,
    status_name,
    subscribe,
)
from pipeline_tracker.nodes.lifecycle import ManagedNode, in_words
from pipeline_tracker.nodes.live_clock import LiveClock
from pipeline_tracker.nodes.mounting import MountingListener, mounting_of_settings
from pipeline_tracker.nodes.parameters import (
    AUTOSTART,
    ParameterGate,
    as_parameters,
    declare_settings,
    read_settings,
)
from pipeline_tracker.nodes.timeline import StampJudge, Timeline
from pipeline_tracker.pipeline import warm_up
from pipeline_tracker.settings import Settings
from pipeline_tracker.validation.ours import check_output

_NO_MOUNTING = "waiting for the camera's mounting on /tf_static"

# One warning of each kind in this time, s.
WARN_EVERY = 5.0


class NotReadyError(PipelineTrackerError):
    """A node that is not at work is asked to do something."""


_POSE_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
}


class PipelineNode(ManagedNode):
    """A managed node whose parameters are the settings.

    Configuring reads and checks the settings and opens the outputs (``open_outputs``); activating
    opens the inputs (``start``); deactivating ends these (``stop``) and forgets the past.
    """

    NAME: ClassVar[str]
    # What the node is given and answers, in a word.
    ITEMS: ClassVar[str] = "frames"

    def __init__(self, parameters: Mapping[str, Any] | None = None, **options: Any) -> None:
        """Make the node, unconfigured; no topic is opened yet.

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
        self._drops_lock = threading.Lock()
        self._warned: dict[str, float] = {}
        self.is_ready = False
        self.health = Health(status_name(self.get_namespace(), self.NAME), self.ITEMS)
        self._qos_watch = QosWatch(self, self.health, self.warn)
        self._speaker = DiagnosticsSpeaker(self, self.reports)
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

    def reports(self) -> Iterable[Report]:
        """Return what is told of the node's health, once a second."""
        self._qos_watch.look()
        return [self.health.report()]

    def became(self, failure: Exception | None = None) -> None:
        """Tell the node's health in which state it is, and what has failed."""
        state = ACTIVE if self.is_active else INACTIVE if self.is_configured else UNCONFIGURED
        self.health.became(state, "" if failure is None else in_words(failure))

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
        compile_kernels(self.settings)
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

    def dropped(self, reason: str, details: str = "", items: int = 0, field: str = "") -> None:
        """Count an input that is not used, and warn once in a while for each reason.

        Args:
            reason: in a word or two.
            details: which one, and why.
            items: how many of what the node is given are lost with it.
            field: of a message, which is warned about by itself.
        """
        if items:
            self.health.ledger.dropped(reason, items)
        else:
            self.health.unused(reason)
        with self._drops_lock:
            self.drops[reason] += 1
            count = self.drops[reason]
        words = f"{reason}: {details}" if details else reason
        self.warn(f"{reason} {field}", f"{words} ({count} so far)")

    def warn(self, kind: str, words: str) -> None:
        """Log a warning, at most once in ``WARN_EVERY`` seconds for each kind."""
        now = time.monotonic()
        if now - self._warned.get(kind, -WARN_EVERY) < WARN_EVERY:
            return
        self._warned[kind] = now
        self.get_logger().warning(words)

    def answered(self, stamp: int, items: int = 1) -> None:
        """Count what has been answered, and how long it took since its stamp, ns."""
        self.health.ledger.processed(items)
        self.health.latency.add((self._now_ns() - stamp) / SECOND_NS)

    def listen(
        self,
        type_name: str,
        topic: str,
        callback: Callable[[Any], None],
        profile: qos.Profile,
        read: Callable[[Any], Any] | None = None,
        need: Need = Need.ALWAYS,
        *,
        counted: bool = False,
    ) -> Subscription:
        """Subscribe to a topic; a message that cannot be used is counted and never ends the node.

        Args:
            type_name: ``package/msg/Name``.
            topic: relative name.
            callback: called with each message, or with what ``read`` makes of it.
            profile: the topic's quality of service.
            read: checks a message and makes something of it; what it raises refuses the message.
            need: what the node does without this topic.
            counted: each message is an item of the node's ledger.
        """
        scope = self.scope
        watch = self.health.watch(topic, need)

        def guarded(message: Any, info: Mapping[str, Any]) -> None:
            # The executor may have taken one more when the topic was closed.
            if not scope.is_open:
                return
            number = info.get("publication_sequence_number")
            self._qos_watch.number(watch, number, subscription)
            self.health.heard(watch, self._age_of(message))
            if counted:
                self.health.ledger.received()
            try:
                given = message if read is None else read(message)
            except Exception as error:  # noqa: BLE001 - whatever a message does, the node lives on
                self.refused(topic, error, int(counted))
                return
            try:
                callback(given)
            except Exception as error:  # noqa: BLE001 - whatever a message does, the node lives on
                self.refused(topic, error)

        subscription = subscribe(
            self,
            self._qos_watch.of_subscription(topic, watch),
            message_class(type_name),
            topic,
            guarded,
            profile.qos(),
            qos_overriding_options=qos.overriding_options(),
        )
        scope.add(self.destroy_subscription, subscription)
        scope.add(self.health.forget, topic)
        return subscription

    def listen_to_poses(self, callback: Callable[[int, Pose], None]) -> Subscription:
        """Subscribe to vnm/pose, of the type that the settings say."""
        kind = _POSE_TYPES[self.settings.pose_type]

        def on_pose(given: tuple[int, Pose]) -> None:
            callback(*given)

        return self.listen(kind, "vnm/pose", on_pose, qos.POSE, pose_from_message, Need.WANTED)

    def speak(self, type_name: str, topic: str) -> Voice:
        """Return a publisher of one of our topics; it is silent while the node is not active."""
        publisher = self.create_lifecycle_publisher(
            message_class(type_name),
            topic,
            qos.PIPELINE.qos(),
            qos_overriding_options=qos.overriding_options(),
            event_callbacks=self._qos_watch.of_publisher(topic),
        )
        self.scope.add(self.destroy_lifecycle_publisher, publisher)
        return Voice(publisher, type_name)

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call something at intervals of the steady clock, which runs when simulated time stops."""
        scope = self.scope

        def guarded() -> None:
            if not scope.is_open:
                return
            try:
                callback()
            except Exception as error:  # noqa: BLE001 - nothing may end the node
                self.refused("timer", error)

        timer = self.create_timer(seconds, guarded, clock=Clock(clock_type=ClockType.STEADY_TIME))
        scope.add(self.destroy_timer, timer)
        return timer

    def serve(self, name: str, do: Callable[[], str]) -> Service:
        """Offer a service of std_srvs/Trigger.

        Args:
            name: relative name, ``~/name`` below the node's own.
            do: does it and returns what was done, in words; where it cannot, it raises a
                ``PipelineTrackerError`` that says why.
        """

        def answer(_: Any, response: Any) -> Any:
            try:
                response.message = do()
                response.success = True
                self.get_logger().info(response.message)
            except Exception as error:  # noqa: BLE001 - nothing may end the node
                response.success, response.message = False, in_words(error)
                self.get_logger().warning(f"{name} refused: {response.message}")
            return response

        service = self.create_service(Trigger, name, answer)
        self.scope.add(self.destroy_service, service)
        return service

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

    def refused(self, what: str, error: Exception, items: int = 0) -> None:
        """Count and report a message, or a step of ours, that failed; see ``dropped``."""
        expected = isinstance(error, PipelineTrackerError | ValueError)
        reason = f"{what} refused" if expected else f"{what} failed"
        self.dropped(reason, in_words(error)[:300], items, str(getattr(error, "field", "")))

    def _stop(self) -> None:
        self.is_ready = False
        self.stop()

    def _age_of(self, message: Any) -> float | None:
        """Return the time since a message's stamp, s; None where it has none."""
        header = getattr(message, "header", message)
        return (self._now_ns() - stamp_ns(header)) / SECOND_NS if hasattr(header, "stamp") else None

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


class Voice:
    """A publisher that lets nothing out that must not be published."""

    def __init__(self, publisher: Publisher, type_name: str) -> None:
        """Take a publisher of ``type_name``, ``package/msg/Name``."""
        self._publisher = publisher
        self._type_name = type_name

    def publish(self, message: Any) -> None:
        """Publish a message.

        Raises:
            MessageError: it has a number that is not finite, or is otherwise impossible.
        """
        check_output(self._type_name, message)
        self._publisher.publish(message)


_compiled: set[bool] = set()


def compile_kernels(settings: Settings) -> None:
    """Compile or load the kernels, once for all nodes of a process."""
    # Of all settings, this one alone decides which kernels are run.
    if settings.tracking.refine not in _compiled:
        warm_up(settings)
        _compiled.add(settings.tracking.refine)


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
