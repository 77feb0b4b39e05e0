"""The nodes' health on /diagnostics, once a second, whatever state they are in."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import (
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible, qos_policy_name_from_kind
from rclpy.subscription import Subscription

from pipeline_tracker.diagnostics.health import Health
from pipeline_tracker.diagnostics.inputs import InputWatch
from pipeline_tracker.diagnostics.levels import Report

TOPIC = "/diagnostics"
EVERY = 1.0
_DEPTH = 10


def status_name(namespace: str, name: str) -> str:
    """Return the name of a node's status: ``node: task``, with the namespace where there is one."""
    return f"{namespace.strip('/')}/{name}: status".lstrip("/")


def overall_name(namespace: str) -> str:
    """Return the name of the status of all nodes together."""
    return f"{namespace.strip('/')}/pipeline_tracker: overall".lstrip("/")


def hardware_id(namespace: str) -> str:
    """Return what all statuses of one vehicle have in common."""
    return f"{namespace.strip('/')}/pipeline_tracker".lstrip("/")


class DiagnosticsSpeaker:
    """Publishes reports once a second, by the steady clock; lives as long as the node itself."""

    def __init__(
        self,
        node: Node,
        reports: Callable[[], Iterable[Report]],
        failed: Callable[[str, Exception], None],
    ) -> None:
        """Begin to publish.

        Args:
            node: which publishes.
            reports: asked for the reports of this moment.
            failed: called with what has failed and its error.
        """
        self._node = node
        self._reports = reports
        self._failed = failed
        self._hardware = hardware_id(node.get_namespace())
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, _DEPTH)
        self._timer = node.create_timer(
            EVERY, self.speak, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def speak(self) -> None:
        """Publish the reports now."""
        try:
            self._publish()
        except Exception as error:  # noqa: BLE001 - nothing may end the node
            self._failed("diagnostics", error)

    def _publish(self) -> None:
        array = DiagnosticArray(status=[self._status(report) for report in self._reports()])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def _status(self, report: Report) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=bytes([report.level]),
            name=report.name,
            message=report.message,
            hardware_id=self._hardware,
            values=[KeyValue(key=key, value=value) for key, value in report.values],
        )


class DiagnosticsListener:
    """Hears the statuses of all nodes."""

    def __init__(self, node: Node, hear: Callable[[str, int, str], None]) -> None:
        """Begin to listen.

        Args:
            node: which listens.
            hear: called with name, level and message of each status.
        """
        self._hear = hear
        node.create_subscription(DiagnosticArray, TOPIC, self._on_array, _DEPTH)

    def _on_array(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._hear(str(status.name), int.from_bytes(status.level, "little"), status.message)


class QosWatch:
    """Tells of ends of a topic that cannot be joined, on both sides, and of messages lost."""

    def __init__(self, node: Node, health: Health, warn: Callable[[str, str], None]) -> None:
        """Watch the topics of a node.

        Args:
            node: whose topics are watched.
            health: what is amiss is put into it.
            warn: called with kind and words of a warning.
        """
        self._node = node
        self._health = health
        self._warn = warn

    def of_subscription(self, topic: str, watch: InputWatch) -> SubscriptionEventCallbacks:
        """Return the callbacks of a subscription."""

        def on_lost(event: Any) -> None:
            # Fast DDS does not tell of what gave way in a full queue: numbers do.
            if watch.number is None:
                self._missed(watch, int(event.total_count_change))

        def on_mismatch(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._mismatched(topic, f"{topic}: a publisher offers less {policy} than is asked for")

        return SubscriptionEventCallbacks(incompatible_qos=on_mismatch, message_lost=on_lost)

    def number(self, watch: InputWatch, number: int | None, subscription: Subscription) -> None:
        """Take in the number that the publisher gave a message, and count those left out."""
        before, watch.number = watch.number, number
        if number is None or before is None or number <= before + 1:
            return
        # Each publisher has numbers of its own.
        if subscription.get_publisher_count() == 1:
            self._missed(watch, number - before - 1)

    def of_publisher(self, topic: str) -> PublisherEventCallbacks:
        """Return the callbacks of a publisher."""

        def on_mismatch(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._mismatched(topic, f"{topic}: a subscriber asks for more {policy} than is offered")

        return PublisherEventCallbacks(incompatible_qos=on_mismatch)

    def look(self) -> None:
        """Forget the mismatches whose other end has gone or has changed."""
        if not self._health.mismatches:
            return
        ends: dict[str, list[Any]] = {}
        here: list[Any] = [*self._node.publishers, *self._node.subscriptions]
        for end in here:
            ends.setdefault(end.topic_name, []).append(end)
        for topic in self._health.mismatches:
            resolved = self._node.resolve_topic_name(topic)
            if all(self._fits(resolved, end) for end in ends.get(resolved, ())):
                self._health.mismatched(topic, "")

    def _missed(self, watch: InputWatch, count: int) -> None:
        watch.lost += count
        topic = watch.topic
        self._warn(f"{topic} lost", f"{topic}: {watch.lost} messages sent that have not come")

    def _fits(self, topic: str, end: Any) -> bool:
        if isinstance(end, Publisher):
            others = self._node.get_subscriptions_info_by_topic(topic)
            pairs = [(end.qos_profile, other.qos_profile) for other in others]
        else:
            others = self._node.get_publishers_info_by_topic(topic)
            pairs = [(other.qos_profile, end.qos_profile) for other in others]
        return all(qos_check_compatible(*pair)[0] != QoSCompatibility.ERROR for pair in pairs)

    def _mismatched(self, topic: str, words: str) -> None:
        self._health.mismatched(topic, words)
        self._warn(f"{topic} mismatch", f"{words}; nothing passes between the two")


def subscribe(node: Node, events: SubscriptionEventCallbacks, *given: Any, **more: Any) -> Any:
    """Create a subscription; a middleware that does not tell of lost messages goes without."""
    try:
        return node.create_subscription(*given, event_callbacks=events, **more)
    except UnsupportedEventTypeError:
        events.message_lost = None
        return node.create_subscription(*given, event_callbacks=events, **more)
