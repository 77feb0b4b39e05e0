r"""A node that follows the pipe through MAVROS: relative states in, velocity setpoints out.

Publishes geometry_msgs/TwistStamped on ``setpoint_velocity/cmd_vel`` (run it in MAVROS's
namespace, or remap) ten times a second: always, zeros too, because ArduSub and PX4 take silence
for a failure. The velocities are along the vehicle's axes, so MAVROS must have
``mav_frame: BODY_NED`` for its plugin setpoint_velocity.

    python examples/mavros_bridge.py --ros-args -r __ns:=/mavros \
        -r pipeline/relative_state:=/pipeline/relative_state
"""

from __future__ import annotations

import math
import sys
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped
from pipe_follower import Command, Gains, PipeFollower
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from pipeline_tracker_msgs.msg import RelativeState

_PERIOD = 0.1


def twist_message(command: Command, stamp: Any, frame: str) -> TwistStamped:
    """Return a setpoint of MAVROS.

    Args:
        command: velocities along the vehicle's axes.
        stamp: builtin_interfaces/Time.
        frame: the vehicle's frame, x forward, y left, z up.
    """
    message = TwistStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame
    message.twist.linear.x = command.surge
    message.twist.linear.z = command.heave
    message.twist.angular.z = command.yaw_rate
    return message


class MavrosBridge(Node):
    """The node; its parameters are those of ``Gains``."""

    def __init__(self, **options: Any) -> None:
        """Stand still until the first valid state."""
        super().__init__("pipe_follower", **options)
        given = {
            name: float(self.declare_parameter(name, default).value)
            for name, default in vars(Gains()).items()
        }
        for name, value in given.items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name}={value:g}: expected a number above 0")
        self._follower = PipeFollower(Gains(**given))
        # Of the steady clock: a clock that is set must neither stop the vehicle nor drive it on.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._setpoints = self.create_publisher(TwistStamped, "setpoint_velocity/cmd_vel", 10)
        self.create_subscription(RelativeState, "pipeline/relative_state", self._see, 10)
        self.create_timer(_PERIOD, self._send, clock=self._steady)

    def _now(self) -> float:
        return float(self._steady.now().nanoseconds) * 1e-9

    def _see(self, state: RelativeState) -> None:
        self._follower.see(state, self._now())

    def _send(self) -> None:
        command = self._follower.command(self._now())
        stamp = self.get_clock().now().to_msg()
        self._setpoints.publish(twist_message(command, stamp, "base_link"))


def main() -> int:
    """Run the node until it is interrupted."""
    rclpy.init()
    try:
        rclpy.spin(MavrosBridge())
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    except ValueError as error:
        sys.stderr.write(f"mavros_bridge: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
