"""The quality of service of every topic, in one place.

Each can be overridden by ROS's parameters, such as
``qos_overrides./stereo/left/image_rect.subscription.reliability: reliable``.
"""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions


@dataclass(frozen=True)
class Profile:
    """A named profile; ROS's own objects are changed in place by overrides, this one is not."""

    reliability: ReliabilityPolicy
    depth: int
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE

    def qos(self) -> QoSProfile:
        """Return a profile for one publisher or subscription."""
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self.depth,
            reliability=self.reliability,
            durability=self.durability,
        )


# Images, camera infos and altimeter.
SENSOR = Profile(ReliabilityPolicy.BEST_EFFORT, 5)
POSE = Profile(ReliabilityPolicy.BEST_EFFORT, 50)
# All pipeline/* topics.
PIPELINE = Profile(ReliabilityPolicy.RELIABLE, 10)
STATIC_TRANSFORM = Profile(ReliabilityPolicy.RELIABLE, 100, DurabilityPolicy.TRANSIENT_LOCAL)
# What `play` publishes: reliable serves subscriptions of both kinds.
PLAYED = Profile(ReliabilityPolicy.RELIABLE, 10)
CLOCK = Profile(ReliabilityPolicy.RELIABLE, 1)


def overriding_options() -> QoSOverridingOptions:
    """Return which policies can be overridden by parameters."""
    return QoSOverridingOptions(
        (
            QoSPolicyKind.HISTORY,
            QoSPolicyKind.DEPTH,
            QoSPolicyKind.RELIABILITY,
            QoSPolicyKind.DURABILITY,
        )
    )
