"""Take the four nodes through their lifecycle again and again: nothing is left behind.

``python test/soak/lifecycle.py --cycles 200`` prints what the process has before and after: ROS
entities, parameters, threads, open files, memory; exit 1 where anything has grown. Every cycle is
configure, activate, a pair of images through all nodes, deactivate and cleanup.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

# What grows once, by the first cycles: caches of libraries, pools of DDS.
WARM_UP = 3
# Growth of the resident memory that is put down to the allocator, bytes: once, and each cycle. The
# images of a frame are 400 kB.
_ONCE, _EACH = 10_000_000, 50_000
_WIDTH, _HEIGHT = 512, 384
_WITHIN = 60.0


@dataclass(frozen=True)
class Count:
    """What a process has."""

    entities: int
    parameters: int
    threads: int
    files: int
    memory: int


def count(nodes: list[Any]) -> Count:
    """Count what the nodes, and this process, have now."""
    gc.collect()
    kinds = ("publishers", "subscriptions", "services", "clients", "timers", "guards")
    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return Count(
        entities=sum(len(list(getattr(node, kind))) for node in nodes for kind in kinds),
        parameters=sum(len(node.get_parameters_by_prefix("")) for node in nodes),
        threads=threading.active_count(),
        files=len(list(Path("/proc/self/fd").iterdir())),
        memory=resident,
    )


class Cycler:
    """The four nodes, and a talker that feeds them, in one executor."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from pipeline_tracker.nodes.live import NODES

        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        parameters = {
            "pipe.diameter": 0.6,
            "camera.translation": [0.0, 0.0, 0.0],
            "camera.rotation_rpy": [3.1416, 0.0, -1.5708],
        }
        self.nodes = [kind(parameters, context=self.context) for kind in NODES]
        self.talker = rclpy.create_node("talker", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in (*self.nodes, self.talker):
            self.executor.add_node(node)
        self._stamp = 1_000_000_000
        self._statuses: list[Any] = []
        self._open_topics()

    def close(self) -> None:
        """End all."""
        self.executor.shutdown()
        for node in (*self.nodes, self.talker):
            if node is not self.talker:
                node.close()
            node.destroy_node()
        self.context.try_shutdown()

    def cycle(self) -> None:
        """Take all nodes through all states, with a frame while they are active."""
        for step in ("configure", "activate"):
            self._all(step)
        self._frame()
        for step in ("deactivate", "cleanup"):
            self._all(step)

    def _all(self, step: str) -> None:
        from rclpy.lifecycle import TransitionCallbackReturn

        for node in self.nodes:
            result = getattr(node, f"trigger_{step}")()
            if result != TransitionCallbackReturn.SUCCESS:
                raise RuntimeError(f"{node.NAME}: {step} failed: {node.failure}")

    def _open_topics(self) -> None:
        from pipeline_tracker.nodes.conversions import message_class

        def publisher(topic: str, kind: str) -> Any:
            return self.talker.create_publisher(message_class(f"sensor_msgs/msg/{kind}"), topic, 5)

        sides = ("left", "right")
        self._images = [publisher(f"stereo/{side}/image_rect", "Image") for side in sides]
        self._infos = [publisher(f"stereo/{side}/camera_info", "CameraInfo") for side in sides]
        status = message_class("pipeline_tracker_msgs/msg/TrackingStatus")
        self.talker.create_subscription(status, "pipeline/status", self._statuses.append, 10)

    def _frame(self) -> None:
        """Send a pair of images and wait for its status."""
        from pipeline_tracker.geometry.camera import Camera
        from pipeline_tracker.messages import camera_info_message, header_message
        from pipeline_tracker.nodes.conversions import LiveMessages

        factory = LiveMessages()
        pixels = np.random.default_rng(0).integers(0, 255, _WIDTH * _HEIGHT).astype(np.uint8)
        self._statuses.clear()
        self._spin_until(self._matched, "topics matched")
        self._stamp += 1_000_000
        for number in range(2):
            camera = Camera(400.0, 400.0, 255.5, 191.5, _WIDTH, _HEIGHT, 0.2 * number)
            self._infos[number].publish(
                camera_info_message(factory, camera, self._stamp, "left_optical")
            )
            self._images[number].publish(
                factory.message(
                    "sensor_msgs/msg/Image",
                    header=header_message(factory, self._stamp, "left_optical"),
                    height=_HEIGHT,
                    width=_WIDTH,
                    step=_WIDTH,
                    encoding="mono8",
                    data=factory.sequence(pixels),
                )
            )
        self._spin_until(lambda: bool(self._statuses), "the frame's status")

    def _matched(self) -> bool:
        """Whether every topic has found both of its ends."""
        every = (*self.nodes, self.talker)
        heard = Counter(s.topic_name for node in every for s in node.subscriptions)
        said = Counter(p.topic_name for node in every for p in node.publishers)
        return all(
            p.get_subscription_count() >= heard[p.topic_name] for n in every for p in n.publishers
        ) and all(
            s.get_publisher_count() >= said[s.topic_name] for n in every for s in n.subscriptions
        )

    def _spin_until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + _WITHIN
        while not condition():
            if time.monotonic() > deadline:
                raise RuntimeError(f"not within {_WITHIN:g} s: {what}")
            self.executor.spin_once(timeout_sec=0.02)


def leaks(domain: int, cycles: int, tell: Callable[[str], None] = lambda _: None) -> list[str]:
    """Cycle and return what has grown, in words."""
    cycler = Cycler(domain)
    try:
        for _ in range(WARM_UP):
            cycler.cycle()
        before = count(cycler.nodes)
        tell(f"after {WARM_UP} cycles: {before}")
        started = time.monotonic()
        for number in range(cycles):
            cycler.cycle()
            if (number + 1) % 50 == 0:
                tell(f"after {WARM_UP + number + 1} cycles: {count(cycler.nodes)}")
        after = count(cycler.nodes)
        seconds = (time.monotonic() - started) / cycles
        grown = (after.memory - before.memory) / cycles
        tell(f"{cycles} cycles, {seconds:.2f} s each: {after}; memory {grown:+.0f} bytes a cycle")
    finally:
        cycler.close()
    return [
        f"{what}: {value} before, {asdict(after)[what]} after"
        for what, value in asdict(before).items()
        if asdict(after)[what] > value + (_ONCE + _EACH * cycles if what == "memory" else 0)
    ]


def main() -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--domain", type=int, default=int(os.environ.get("ROS_DOMAIN_ID", "88")))
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def tell(text: str) -> None:
        print(text, flush=True)  # noqa: T201 - a command's output

    grown = leaks(options.domain, options.cycles, tell)
    for words in grown:
        tell(f"grown: {words}")
    return 1 if grown else 0


if __name__ == "__main__":
    sys.exit(main())
