"""The mounting from /tf_static, where transforms can be received."""

from __future__ import annotations

from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.settings_io import load_settings

pytestmark = pytest.mark.ros


class FakeNode:
    """Hands out what was listened to. The type of the messages is not installed from wheels."""

    def __init__(self, *overrides: str) -> None:
        self.settings = load_settings(None, ["pipe.diameter=0.6", *overrides])
        self.heard: dict[str, Any] = {}
        self.errors: list[str] = []

    def listen(self, _type_name: str, topic: str, callback: Any, _profile: Any, **_: Any) -> str:
        self.heard[topic] = callback
        return topic

    def every(self, _seconds: float, callback: Any) -> str:
        self.heard["reminder"] = callback
        return "reminder"

    def destroy_subscription(self, topic: str) -> None:
        del self.heard[topic]

    def destroy_timer(self, timer: str) -> None:
        del self.heard[timer]

    def get_logger(self) -> Any:
        return Message(error=self.errors.append)


def transform(parent: str, child: str, x: float) -> Message:
    return Message(
        header=Message(frame_id=parent),
        child_frame_id=child,
        transform=Message(
            translation=Message(x=x, y=0.0, z=0.0), rotation=Message(x=1.0, y=0.0, z=0.0, w=0.0)
        ),
    )


@pytest.mark.parametrize("named", ["by the camera info", "by the settings"])
def test_a_chain_of_transforms_gives_the_mounting_once(named: str) -> None:
    from pipeline_tracker.nodes.mounting import MountingListener

    overrides = ["frames.left_optical=left_optical"] if named == "by the settings" else []
    node, found = FakeNode(*overrides), list[Pose]()
    MountingListener(node, found.append)  # type: ignore[arg-type]
    if named == "by the camera info":
        node.heard["stereo/left/camera_info"](Message(header=Message(frame_id="left_optical")))
    node.heard["/tf_static"](Message(transforms=[transform("rig", "left_optical", 0.25)]))
    assert not found
    node.heard["reminder"]()
    assert "no static transform from base_link to left_optical" in node.errors[0]
    node.heard["/tf_static"](Message(transforms=[transform("base_link", "rig", 1.0)]))
    (mounting,) = found
    np.testing.assert_allclose(mounting.translation, [1.25, 0.0, 0.0])
    np.testing.assert_allclose(mounting.rotation, np.eye(3), atol=1e-12)
    # It no longer listens.
    assert node.heard == {}
