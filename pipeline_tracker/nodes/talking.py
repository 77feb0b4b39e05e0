"""A node's topics, timers and services, with the account of what comes in and goes out."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from pipeline_tracker.diagnostics.health import ACTIVE, INACTIVE, UNCONFIGURED, Health
from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.diagnostics.levels import Report
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.messages import stamp_ns
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import LiveMessages, message_class
from pipeline_tracker.nodes.diagnostics import (
    DiagnosticsSpeaker,
    QosWatch,
    status_name,
    subscribe,
)
from pipeline_tracker.nodes.lifecycle import ManagedNode, in_words
from pipeline_tracker.validation.ours import check_output

# One warning of each kind in this time, s.
WARN_EVERY = 5.0


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

    def get_subscription_count(self) -> int:
        """Return how many listen."""
        return int(self._publisher.get_subscription_count())


class TalkingNode(ManagedNode):
    """A managed node that never ends of a message, and tells how it is.

    Attributes:
        messages: makes rclpy's messages.
        drops: how often an input was not used, by reason.
        health: what is told on /diagnostics, from the node's start to its end.
    """

    NAME: ClassVar[str]
    # What the node is given and answers, in a word.
    ITEMS: ClassVar[str] = "frames"

    def __init__(self, **options: Any) -> None:
        """Make the node, unconfigured; ``options`` are those of ``rclpy.node.Node``."""
        super().__init__(self.NAME, **options)
        self.messages = LiveMessages()
        self.drops: Counter[str] = Counter()
        self._drops_lock = threading.Lock()
        self._warned: dict[str, float] = {}
        self.health = Health(status_name(self.get_namespace(), self.NAME), self.ITEMS)
        self._qos_watch = QosWatch(self, self.health, self.warn)
        self._speaker = DiagnosticsSpeaker(self, self.reports, self.refused)

    def reports(self) -> Iterable[Report]:
        """Return what is told of the node's health, once a second."""
        self._qos_watch.look()
        return [self.health.report()]

    def became(self, failure: Exception | None = None) -> None:
        """Tell the node's health in which state it is, and what has failed."""
        state = ACTIVE if self.is_active else INACTIVE if self.is_configured else UNCONFIGURED
        self.health.became(state, "" if failure is None else in_words(failure))

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
        self.debug(words)
        self.warn(f"{reason} {field}", f"{words} ({count} so far)")

    def refused(self, what: str, error: Exception, items: int = 0) -> None:
        """Count and report a message, or a step of ours, that failed; see ``dropped``."""
        expected = isinstance(error, PipelineTrackerError | ValueError)
        reason = f"{what} refused" if expected else f"{what} failed"
        self.dropped(reason, in_words(error)[:300], items, str(getattr(error, "field", "")))

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
        self.debug(f"{stamp} ns: answered")

    def debug(self, words: str) -> None:
        """Log what becomes of a single item, where that is asked for."""
        self.get_logger().debug(words)

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

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _age_of(self, message: Any) -> float | None:
        """Return the time since a message's stamp, s; None where it has none."""
        header = getattr(message, "header", message)
        return (self._now_ns() - stamp_ns(header)) / SECOND_NS if hasattr(header, "stamp") else None
