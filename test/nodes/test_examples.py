"""The examples that need ROS."""

from __future__ import annotations

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
        assert twist.linear.z == pytest.approx(-0.5 * 0.2)
        assert twist.angular.z == pytest.approx(0.8 * 0.1)
        assert twist.linear.y == twist.angular.x == twist.angular.y == 0.0
    finally:
        executor.shutdown()
        bridge.destroy_node()
        autopilot.destroy_node()
        rclpy.shutdown(context=context)
