"""The examples that need ROS."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pipe_follower import Gains


@pytest.mark.ros
def test_the_bridge_sends_zeros_then_what_the_law_says(domain: int) -> None:
    import rclpy
    from mavros_bridge import MavrosBridge
    from rclpy.executors import SingleThreadedExecutor

    from pipeline_tracker.nodes.conversions import message_class

    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    bridge = MavrosBridge(context=context)
    autopilot = rclpy.create_node("autopilot", context=context)
    heard: list[Any] = []
    autopilot.create_subscription(
        message_class("geometry_msgs/msg/TwistStamped"),
        "setpoint_velocity/cmd_vel",
        heard.append,
        10,
    )
    state_out = autopilot.create_publisher(
        message_class("pipeline_tracker_msgs/msg/RelativeState"), "pipeline/relative_state", 10
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(bridge)
    executor.add_node(autopilot)
    try:
        for _ in range(600):
            executor.spin_once(timeout_sec=0.1)
            if len(heard) >= 3:
                break
        assert [message.twist.linear.x for message in heard[:3]] == [0.0, 0.0, 0.0]
        assert heard[0].header.frame_id == "base_link"
        state = message_class("pipeline_tracker_msgs/msg/RelativeState")(
            valid=True, heading_misalignment=0.1, min_distance_base=2.2
        )
        for _ in range(600):
            state_out.publish(state)
            executor.spin_once(timeout_sec=0.1)
            if heard[-1].twist.linear.x > 0.0:
                break
        twist = heard[-1].twist
        assert twist.linear.x == Gains().speed
        assert twist.linear.z == pytest.approx(-Gains().climb * 0.2)
        assert twist.angular.z == pytest.approx(Gains().turn * 0.1)
        assert twist.linear.y == twist.angular.x == twist.angular.y == 0.0
    finally:
        executor.shutdown()
        bridge.destroy_node()
        autopilot.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.ros
def test_the_closed_loop_begins_to_close(domain: int, tmp_path: Path) -> None:
    """The first metre; the whole way takes a minute and a half."""
    script = Path(__file__).parents[2] / "examples" / "follow_pipe.py"
    size = ("--length", "1.3", "--width", "320", "--settled", "1.2")
    done = subprocess.run(
        [sys.executable, str(script), "--output", str(tmp_path), *size],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300.0,
        check=False,
    )
    # It is not yet beside the pipe's axis, and says so by its exit code.
    assert done.returncode == 1, done.stdout
    with (tmp_path / "path.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert sum(float(row["valid"]) for row in rows) > 0.7 * len(rows), done.stdout
    aside = [float(row["cross_track"]) for row in rows]
    # It drifted on a little before it turned.
    assert aside[-1] < min(aside[0], max(aside) - 0.05)
    assert (tmp_path / "path.png").stat().st_size > 10_000
