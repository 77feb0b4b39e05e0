"""Mutate messages of every sort: only our error type, nothing that is not finite, bounded time.

``python test/soak/fuzz_messages.py --count 20000`` reads mutated messages of rosbags' and rclpy's
classes, and feeds mutated ones to the four live nodes, in the midst of sound ones. It prints what
became of them; exit 1 at the first that raised anything else, hung, ended a node or its thread,
made one publish a number that is not finite, or that is missing in an account.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import time
from collections import Counter, deque
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "helpers"))

import mutations
import numpy as np
from soaking import attempt, bounded, memory_mib, say, say_counts

from pipeline_tracker import messages
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.validation.fields import check_finite

SECONDS, GROWTH_MIB = 20, 512
PERIOD_NS = 100_000_000

# Which sort of message goes to which topic.
TOPICS = {
    "stereo/left/image_rect": "image",
    "stereo/right/image_rect": "image",
    "stereo/left/camera_info": "camera_info",
    "stereo/right/camera_info": "camera_info",
    "vnm/pose": "pose",
    "pipeline/vectorized": "vectorized",
    "pipeline/recognition": "segment",
    "pipeline/recognition_request": "request",
    "pipeline/segment": "segment",
    "pipeline/status": "status",
}


def restamped(message: Any, stamp_ns: int) -> Any:
    header = getattr(message, "header", message)
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


class Readers:
    """The conversions by themselves, in both worlds."""

    def __init__(self, factories: dict[str, Any]) -> None:
        self._sound = {
            (world, kind): mutations.KINDS[kind][0](factory)
            for world, factory in factories.items()
            for kind in mutations.KINDS
        }

    def attempt(self, rng: random.Random) -> str:
        world, kind = rng.choice(sorted(self._sound))
        message, _ = mutations.mutated(self._sound[world, kind], rng)
        read = mutations.KINDS[kind][1]
        return f"{kind} of {world}: {attempt(lambda: read(message), PipelineTrackerError)}"


class Nodes:
    """The four nodes; what one publishes is given to the others without a middleware."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.publisher import Publisher

        from pipeline_tracker.nodes.conversions import LiveMessages
        from pipeline_tracker.nodes.launcher import node_parameters
        from pipeline_tracker.nodes.live import NODES
        from pipeline_tracker.settings_io import load_settings

        settings = load_settings(
            None,
            [
                "pipe.diameter=0.6",
                "camera.translation=[0, 0, 0]",
                "camera.rotation_rpy=[3.1416, 0, -1.5708]",
                "pose.wait=0.0",
            ],
        )
        rclpy.init(args=[])
        self.factory = LiveMessages()
        self.spoken: deque[tuple[str, Any]] = deque()
        Publisher.publish = lambda publisher, message: self.spoken.append(
            (publisher.topic_name.removeprefix("/"), message)
        )
        self.nodes = [kind(node_parameters(settings)) for kind in NODES]
        for node in self.nodes:
            assert node.trigger_configure().name == "SUCCESS"
        for node in self.nodes:
            assert node.trigger_activate().name == "SUCCESS"
            # The log of 20,000 refusals is of no use to anybody.
            node.get_logger().set_level(rclpy.logging.LoggingSeverity.FATAL)
        self._ears: dict[str, list[Any]] = {}
        for node in self.nodes:
            for subscription in node.subscriptions:
                topic = subscription.topic_name.removeprefix("/")
                self._ears.setdefault(topic, []).append(subscription.callback)
        # Bags have old stamps too: these never come near the clock, which then does not judge.
        self._stamp = mutations.STAMP
        self._sound = {
            topic: mutations.KINDS[kind][0](self.factory) for topic, kind in TOPICS.items()
        }
        self._sound["stereo/left/camera_info"] = messages.camera_info_message(
            self.factory, mutations.RIG.left, mutations.STAMP, "left_optical"
        )
        self.published: Counter[str] = Counter()

    def attempt(self, rng: random.Random) -> str:
        """Give a mutated message, now and then amid a sound frame."""
        topic = rng.choice(sorted(TOPICS))
        if rng.random() < 0.1:
            self._frame()
        else:
            self._stamp += PERIOD_NS
        sound = restamped(self._sound[topic], self._stamp)
        message, _ = mutations.mutated(sound, rng)
        before = self._drops()
        self._give(topic, message)
        self._settle()
        return (
            f"{topic} of the nodes: {'refused or dropped' if self._drops() > before else 'taken'}"
        )

    def _frame(self) -> None:
        self._stamp += PERIOD_NS
        factory = self.factory
        pose = Pose(np.eye(3), np.array([0.0, 0.0, 2.3]))
        placed = messages.pose_stamped_message(factory, pose, self._stamp, "odom")
        self._give("vnm/pose", placed)
        for kind in ("camera_info", "image_rect"):
            for side in ("left", "right"):
                topic = f"stereo/{side}/{kind}"
                self._give(topic, restamped(self._sound[topic], self._stamp))
        self._settle()

    def _give(self, topic: str, message: Any) -> None:
        for callback in self._ears.get(topic, ()):
            callback(message, {})

    def _settle(self) -> None:
        """Let the threads compute, and pass on what is published, until nothing moves."""
        while True:
            busy = any(worker.busy for worker in self._workers())
            if not self.spoken:
                if not busy:
                    return
                time.sleep(0.0005)
                continue
            topic, message = self.spoken.popleft()
            check_finite(message)
            self.published[topic] += 1
            self._give(topic, message)

    def _workers(self) -> list[Any]:
        return [node._worker for node in self.nodes if hasattr(node, "_worker")]

    def _drops(self) -> int:
        return sum(sum(node.drops.values()) for node in self.nodes)

    def check(self) -> None:
        """Check that all threads live and all accounts are complete."""
        for worker in self._workers():
            assert worker._thread.is_alive(), "a computing thread has ended"
        for node in self.nodes:
            node.reports()
            account = node.health.ledger.account()
            assert 0 <= account.waiting <= 40, (node.NAME, account)

    def close(self) -> None:
        import rclpy

        for node in self.nodes:
            node.trigger_deactivate()
            account = node.health.ledger.account()
            assert account.waiting == 0, (node.NAME, account)
            assert account.received == account.processed + account.lost
            say(
                f"{node.NAME}: {account.received} {node.ITEMS} received, "
                f"{account.processed} processed, {account.lost} dropped {dict(account.dropped)}"
            )
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    # Nobody else is to hear.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    nodes = Nodes()
    readers = Readers({"rosbags": BagMessages(), "rclpy": nodes.factory})
    outcomes: Counter[str] = Counter()
    slowest, started = 0.0, time.monotonic()
    for _ in range(20):
        nodes._frame()
    before = memory_mib()
    for index in range(given.seed, given.seed + given.count):
        rng = random.Random(index)  # noqa: S311 - a test's dice
        start = time.monotonic()
        with bounded(SECONDS, f"--seed {index} --count 1"):
            outcomes[(nodes if index % 2 else readers).attempt(rng)] += 1
        slowest = max(slowest, time.monotonic() - start)
        if index % 100 == 0:
            nodes.check()
    growth = memory_mib() - before
    say_counts(outcomes)
    nodes.close()
    spent = time.monotonic() - started
    say(
        f"{given.count} messages in {spent:.0f} s, {sum(nodes.published.values())} published; "
        f"slowest {slowest:.2f} s; memory grew by {growth:.0f} MiB"
    )
    return int(growth > GROWTH_MIB)


if __name__ == "__main__":
    sys.exit(main())
