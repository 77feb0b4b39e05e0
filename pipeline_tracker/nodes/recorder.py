"""The recording process of `run --record`: messages as the bytes that they are, to an mcap bag.

It is a process of its own, so that the nodes never wait for a disk.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
import rclpy.utilities
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from pipeline_tracker.bags.typestore import our_typestore
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.conversions import message_class
from pipeline_tracker.nodes.process import Stop, say
from pipeline_tracker.nodes.recorder_process import RecordedTopic
from pipeline_tracker.nodes.runtime import end_with_parent
from pipeline_tracker.replay.result_bag import LATCHED

_PROFILES = {
    "pipeline": qos.Profile(qos.PIPELINE.reliability, 100),
    "sensor": qos.SENSOR,
    "pose": qos.POSE,
    "static": qos.STATIC_TRANSFORM,
}
# Bytes that wait for the disk; images give way first.
_MOST_WAITING, _MOST_WITH_IMAGES = 96_000_000, 64_000_000
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# What is written reaches the disk after this time at the latest, s: a computer that loses its
# power loses no more.
_FLUSH_EVERY = 1.0
_WARN_EVERY = 5.0
# After the nodes' end: what is under way arrives, s.
_LINGER = 0.3


class BagFile:
    """Writes messages in a thread of its own, in the order in which they came."""

    def __init__(self, directory: Path, *, compress: bool) -> None:
        """Create the bag and start the thread.

        Args:
            directory: of the bag; created.
            compress: chunks by zstd; images gain little by it.

        Raises:
            OSError: it cannot be created.
        """
        self.failure: OSError | None = None
        self.written = 0
        self.lost: Counter[str] = Counter()
        self._writer = Writer(
            directory, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
        )
        if compress:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        self._connections: dict[str, Connection] = {}
        self._items: deque[tuple[RecordedTopic, str, int, bytes]] = deque()
        self._waiting = 0
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="bag")
        self._thread.start()

    def put(self, topic: RecordedTopic, name: str, raw: bytes) -> bool:
        """Give it a message; return False where too much waits, and this one is lost.

        Args:
            topic: what it is.
            name: the topic's full name.
            raw: CDR bytes.
        """
        most = _MOST_WITH_IMAGES if topic.type_name in _IMAGES else _MOST_WAITING
        with self._changed:
            if self.failure is not None or self._waiting + len(raw) > most:
                self.lost[name] += 1
                return False
            self._items.append((topic, name, time.time_ns(), raw))
            self._waiting += len(raw)
            self._changed.notify()
        return True

    def close(self) -> None:
        """Write what waits, and finish the bag."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()
        if not self.written and self.failure is None:
            # A bag of nothing would only be in the way of the next recording.
            shutil.rmtree(self._writer.path)

    def _run(self) -> None:
        try:
            while self._write_some():
                self._flush()
            self._writer.close()
        except OSError as error:
            with self._changed:
                self.failure = error
                self._items.clear()
            # Where the disk is full, closing fails too.
            with suppress(OSError):
                self._writer.abort()

    def _write_some(self) -> bool:
        """Write for as long as until the next flush; return whether there may be more."""
        deadline = time.monotonic() + _FLUSH_EVERY
        while (left := deadline - time.monotonic()) > 0.0:
            with self._changed:
                self._changed.wait_for(lambda: self._items or self._ended, left)
                if not self._items:
                    if self._ended:
                        return False
                    continue
                topic, name, log_ns, raw = self._items.popleft()
            self._writer.write(self._connection(topic, name), log_ns, raw)
            with self._changed:
                self.written += 1
                self._waiting -= len(raw)
        return True

    def _flush(self) -> None:
        """Bring what is written to the disk, so that `salvage` finds it there."""
        storage: Any = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()
            os.fsync(storage.bio.fileno())

    def _connection(self, topic: RecordedTopic, name: str) -> Connection:
        if name not in self._connections:
            latched = topic.profile == "static"
            self._connections[name] = self._writer.add_connection(
                name,
                topic.type_name,
                typestore=our_typestore(),
                offered_qos_profiles=[LATCHED] if latched else (),
            )
        return self._connections[name]


class Recorder:
    """The node that listens."""

    def __init__(self, directory: Path, topics: list[RecordedTopic]) -> None:
        """Create the bag and subscribe.

        Raises:
            OSError: the bag cannot be created.
        """
        images = any(topic.type_name in _IMAGES for topic in topics)
        self._file = BagFile(directory, compress=not images)
        self._directory = directory
        self._warned = -_WARN_EVERY
        self._received = 0
        self.node = rclpy.create_node("recorder")
        # Of the topics that the nodes publish from their start on.
        self._results: list[Subscription] = []
        # Of the others, those that nobody has published yet.
        self._silent: list[Subscription] = []
        for topic in topics:
            self._listen(topic)

    def live(self, stop: Stop) -> int:
        """Record until told to stop; return the exit code."""
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        hears_nodes = False
        while stop.wait(0.0) is None and self._file.failure is None:
            executor.spin_once(timeout_sec=0.1)
            if not hears_nodes and all(s.get_publisher_count() for s in self._results):
                hears_nodes = True
                self.node.get_logger().info("hears all nodes")
            for subscription in [s for s in self._silent if s.get_publisher_count()]:
                self._silent.remove(subscription)
                self.node.get_logger().info(f"hears {subscription.topic_name}")
        deadline, received = time.monotonic() + _LINGER, -1
        while time.monotonic() < deadline or self._received != received:
            received = self._received
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown(timeout_sec=0.0)
        self._file.close()
        return self._report()

    def _listen(self, topic: RecordedTopic) -> None:
        def take(raw: bytes) -> None:
            self._received += 1
            if not self._file.put(topic, subscription.topic_name, raw):
                self._warn(subscription.topic_name)

        subscription = self.node.create_subscription(
            message_class(topic.type_name),
            topic.name,
            take,
            _PROFILES[topic.profile].qos(),
            raw=True,
        )
        ours = topic.name.startswith("pipeline/")
        (self._results if ours else self._silent).append(subscription)

    def _warn(self, name: str) -> None:
        if time.monotonic() - self._warned < _WARN_EVERY or self._file.failure is not None:
            return
        self._warned = time.monotonic()
        self.node.get_logger().warning(
            f"{sum(self._file.lost.values())} messages not recorded so far, the last of {name}: "
            "the disk is too slow"
        )

    def _report(self) -> int:
        failure, lost = self._file.failure, sum(self._file.lost.values())
        if failure is not None:
            say(
                f"{self._directory}: the recording ended early ({failure.strerror or failure}); "
                "`salvage` reads what is there",
                error=True,
            )
            return 1
        if not self._file.written:
            say(f"{self._directory}: nothing came that could be recorded; there is no bag")
            return 0
        words = f", {lost} were lost: the disk was too slow" if lost else ""
        say(f"recorded {self._directory}: {self._file.written} messages{words}")
        return 0


def main() -> int:
    """Record; the command line has directory, topics as JSON, and ``--ros-args``."""
    directory, plan, *ros_args = sys.argv[1:]
    stop = Stop()
    stop.on_signals(0)
    end_with_parent(stop)
    topics = [RecordedTopic(**topic) for topic in json.loads(plan)]
    rclpy.init(args=ros_args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        return Recorder(Path(directory), topics).live(stop)
    except OSError as error:
        say(f"{directory}: cannot be written ({error.strerror or error})", error=True)
        return 1
    finally:
        rclpy.utilities.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
