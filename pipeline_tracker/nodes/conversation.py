"""Two processes that find each other and pass images: what `doctor` listens to.

Run as a module it starts a listener, speaks to it and prints one line of JSON: seconds until they
found each other (-1: never), images sent and received, median way of an image in ms.
"""

from __future__ import annotations

import array
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.node import Node

from pipeline_tracker.nodes.conversions import message_class
from pipeline_tracker.nodes.process import prepare_transport
from pipeline_tracker.nodes.qos import PIPELINE, SENSOR

_WIDTH, _HEIGHT = 1200, 800
_IMAGES = 20
_EVERY = 0.05
_FIND_WITHIN, _LAST_WITHIN = 20.0, 2.0
_LISTEN = "--listen"


def _spin_until(node: Node, met: Callable[[], bool], seconds: float) -> bool:
    """Spin a node until a condition is met; return whether it was in time."""
    deadline = time.monotonic() + seconds
    while not met():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return False
        rclpy.spin_once(node, timeout_sec=min(left, 0.1))
    return True


def _listen(topic: str) -> None:
    """Answer each image with its header, until standard input ends."""
    rclpy.init()
    node = Node("doctor_listener")
    answers = node.create_publisher(
        message_class("std_msgs/msg/Header"), f"{topic}/heard", PIPELINE.qos()
    )

    def answer(image: Any) -> None:
        answers.publish(image.header)

    node.create_subscription(
        message_class("sensor_msgs/msg/Image"), f"{topic}/image", answer, SENSOR.qos()
    )
    parent = os.getppid()
    _spin_until(node, lambda: os.getppid() != parent, _FIND_WITHIN + 30.0)


def _speak(topic: str) -> dict[str, float]:
    """Send images and measure how they are heard."""
    rclpy.init()
    node = Node("doctor_speaker")
    ways: list[float] = []
    sent: dict[int, float] = {}

    def hear(header: Any) -> None:
        ways.append(1e3 * (time.monotonic() - sent[int(header.stamp.sec)]))

    images = node.create_publisher(
        message_class("sensor_msgs/msg/Image"), f"{topic}/image", SENSOR.qos()
    )
    heard = node.create_subscription(
        message_class("std_msgs/msg/Header"), f"{topic}/heard", hear, PIPELINE.qos()
    )
    start = time.monotonic()

    def found() -> bool:
        return images.get_subscription_count() > 0 and node.count_publishers(heard.topic_name) > 0

    if not _spin_until(node, found, _FIND_WITHIN):
        return {"found_s": -1.0, "sent": 0, "received": 0, "median_ms": 0.0}
    found_s = time.monotonic() - start
    image = message_class("sensor_msgs/msg/Image")()
    image.width, image.height, image.step, image.encoding = _WIDTH, _HEIGHT, _WIDTH, "mono8"
    image.data = array.array("B", bytes(_WIDTH * _HEIGHT))
    for number in range(_IMAGES):
        image.header.stamp.sec = number
        sent[number] = time.monotonic()
        images.publish(image)
        _spin_until(node, lambda: False, _EVERY)
    _spin_until(node, lambda: len(ways) >= _IMAGES, _LAST_WITHIN)
    median = statistics.median(ways) if ways else 0.0
    return {"found_s": found_s, "sent": _IMAGES, "received": len(ways), "median_ms": median}


def main() -> int:
    """Speak, with a listener in a process of its own; print what was heard."""
    prepare_transport(local=True)
    if _LISTEN in sys.argv:
        _listen(sys.argv[-1])
        return 0
    topic = f"pipeline_tracker_doctor_{os.getpid()}"
    command = [sys.executable, "-m", __spec__.name, _LISTEN, topic]
    listener = subprocess.Popen(command, stdin=subprocess.DEVNULL)  # noqa: S603 - this module
    try:
        told = _speak(topic)
    finally:
        listener.kill()
        listener.wait()
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
