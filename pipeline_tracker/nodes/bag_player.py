"""A node that publishes a bag as it was recorded."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import rclpy
import rclpy.utilities
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from pipeline_tracker.bags.reader import BagReader, BagRecord
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import message_class
from pipeline_tracker.nodes.process import Stop, say

# Subscribers of the image topics are waited for at most this long, s.
MATCH_WITHIN = 10.0
# No new subscriber for this long: whoever wants to listen listens, s.
_SETTLED_AFTER = 0.5
_LOOK_EVERY = 0.02
# /clock is published this often, s of real time, as `ros2 bag play` does.
_TICK = 0.025
# After the last message, s of real time: what is under way arrives.
_LINGER = 0.5

_IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_ABSOLUTE = ("/tf", "/tf_static", "/rosout")


def play(
    reader: BagReader,
    rate: float,
    *,
    loop: bool,
    args: Sequence[str],
    stop: Stop,
    quiet: bool = False,
) -> int:
    """Publish an open bag; return the exit code.

    Args:
        reader: the bag.
        rate: how many times as fast as it was recorded.
        loop: begin again at the end.
        args: command line with ``--ros-args``.
        stop: ends the play early.
        quiet: say nothing but errors.

    Raises:
        BagError: the bag is damaged.
    """
    rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _Player(reader, rate, stop, quiet=quiet).play(loop=loop)
    finally:
        rclpy.utilities.try_shutdown()


class _Player:
    """A node that publishes the messages of a bag as the bytes that they are."""

    def __init__(self, reader: BagReader, rate: float, stop: Stop, *, quiet: bool) -> None:
        self._reader = reader
        self._rate = rate
        self._stop = stop
        self._quiet = quiet
        self._node = rclpy.create_node("bag_player")
        self._sent: Counter[str] = Counter()
        self._publishers: dict[str, Any] = {}
        self._open_topics()
        self._clock = self._node.create_publisher(Clock, "/clock", qos.CLOCK.qos())
        self._ticked = float("-inf")

    def play(self, *, loop: bool) -> int:
        """Play the bag once, or again and again; return the exit code."""
        code = self._wait_for_subscribers()
        laps = 0
        while code is None:
            code = self._play_once()
            laps += 1
            if code is None and not loop:
                code = 0
        total = sum(self._sent.values())
        times = f" in {laps} laps" if loop else ""
        self._say(f"played {self._reader.path}: {total} messages{times}")
        for topic, count in sorted(self._sent.items()):
            self._say(f"  {count:7d}  {topic}")
        self._node.destroy_node()
        return code or 0

    def _say(self, text: str, *, error: bool = False) -> None:
        if not self._quiet:
            say(text, error=error)

    def _open_topics(self) -> None:
        left_out: dict[str, list[str]] = {}
        for topic in self._reader.topics.values():
            # The bag's own clock gives way to the one that is played.
            if topic.name == "/clock":
                continue
            try:
                kind = message_class(topic.type_name)
            except ImportError:
                left_out.setdefault(topic.type_name or "several types", []).append(topic.name)
                continue
            name = topic.name if topic.name in _ABSOLUTE else topic.name.lstrip("/")
            latched = topic.name.rsplit("/", 1)[-1] == "tf_static"
            profile = qos.STATIC_TRANSFORM if latched else qos.PLAYED
            self._publishers[topic.name] = self._node.create_publisher(kind, name, profile.qos())
        if left_out:
            words = "; ".join(f"{', '.join(names)} ({kind})" for kind, names in left_out.items())
            self._say(
                f"warning: left out, the Python package of the type is not installed: {words}",
                error=True,
            )

    def _wait_for_subscribers(self) -> int | None:
        """Wait until all image topics have subscribers and no new one comes, 10 s at most."""
        images = [
            publisher
            for name, publisher in self._publishers.items()
            if self._reader.topics[name].type_name in _IMAGE_TYPES
        ]
        started = changed = time.monotonic()
        counts: list[int] = []
        while time.monotonic() - started < MATCH_WITHIN:
            now = [p.get_subscription_count() for p in (*self._publishers.values(), self._clock)]
            if now != counts:
                counts, changed = now, time.monotonic()
            wanted = all(publisher.get_subscription_count() > 0 for publisher in images)
            if wanted and time.monotonic() - changed >= _SETTLED_AFTER:
                return None
            code = self._stop.wait(_LOOK_EVERY)
            if code is not None:
                return code
        lonely = [p.topic_name for p in images if p.get_subscription_count() == 0]
        if lonely:
            names = ", ".join(lonely)
            hint = ""
            if all(name.endswith("/compressed") for name in lonely):
                hint = " (`run` does with --set image_transport=compressed)"
            self._say(f"warning: nobody listens to {names}{hint}; playing all the same", error=True)
        return None

    def _play_once(self) -> int | None:
        """Publish all messages once, on an absolute schedule; return the code of a signal."""
        first = self._reader.start_ns
        started = time.monotonic()
        self._ticked = float("-inf")
        for record in self._reader.records(list(self._publishers)):
            code = self._sleep_until(started, first, record.log_ns)
            if code is not None:
                return code
            if time.monotonic() - self._ticked >= _TICK:
                self._tick(record.log_ns)
            publisher = self._publishers[record.topic]
            publisher.publish(_cdr(record))
            self._sent[publisher.topic_name] += 1
        # The clock runs on for a moment, so that the last image is dealt with in its own time.
        end = self._reader.end_ns + round(_LINGER * self._rate * SECOND_NS)
        return self._sleep_until(started, first, end)

    def _sleep_until(self, started: float, first: int, log_ns: int) -> int | None:
        """Wait for a message's time; the clock ticks meanwhile. Return the code of a signal."""
        due = started + (log_ns - first) / SECOND_NS / self._rate
        while (left := due - time.monotonic()) > 0.0:
            now = log_ns - round(left * self._rate * SECOND_NS)
            if time.monotonic() - self._ticked >= _TICK:
                self._tick(now)
            next_tick = self._ticked + _TICK - time.monotonic()
            code = self._stop.wait(max(0.001, min(left, next_tick)))
            if code is not None:
                return code
        return self._stop.wait(0.0)

    def _tick(self, now_ns: int) -> None:
        self._ticked = time.monotonic()
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, SECOND_NS)
        self._clock.publish(message)


def _cdr(record: BagRecord) -> bytes:
    """Return a message as ROS 2 serializes it."""
    if record.reader.is2:
        return bytes(record.raw)
    return bytes(record.reader.typestore.ros1_to_cdr(record.raw, record.type_name))
