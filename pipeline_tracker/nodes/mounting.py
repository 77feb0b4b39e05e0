"""The camera's mounting for live nodes: from the settings, else from /tf_static."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.errors import CalibrationError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import transform_from_message
from pipeline_tracker.mounting import StaticTransforms, find_mounting, mounting_from_settings
from pipeline_tracker.nodes import qos
from pipeline_tracker.settings import Settings

if TYPE_CHECKING:
    from pipeline_tracker.nodes.base import PipelineNode

# The mounting is asked after in the log in this time, s.
_REMIND_EVERY = 5.0


def mounting_of_settings(settings: Settings) -> Pose | None:
    """Return base_link <- left optical frame; None where only /tf_static can give it.

    Raises:
        SettingsError: one half of it is given without the other.
        CalibrationError: the settings do not give it, and transforms cannot be received.
    """
    given = mounting_from_settings(settings)
    if given is None and find_spec("tf2_msgs") is None:
        raise CalibrationError(
            "the camera's mounting is not known: camera.translation and camera.rotation_rpy are "
            "not given, and /tf_static cannot be received (the Python package tf2_msgs is not "
            "installed); give both settings, for example --set camera.translation=[0.3,0.1,-0.1] "
            "--set camera.rotation_rpy=[3.1416,0,-1.5708]"
        )
    return given


class MountingListener:
    """Waits for the static transform of the left camera; until then the node does nothing."""

    def __init__(self, node: PipelineNode, found: Callable[[Pose], None]) -> None:
        """Listen to /tf_static, and to the left camera info for the name of the camera's frame.

        Args:
            node: which waits.
            found: called once with base_link <- left optical frame.
        """
        self._node = node
        self._settings = node.settings
        self._found = found
        self._optical = self._settings.frames.left_optical
        self._transforms = StaticTransforms()
        self._transforms_in = node.listen(
            "tf2_msgs/msg/TFMessage",
            "/tf_static",
            self._on_transforms,
            qos.STATIC_TRANSFORM,
            need=Need.AT_TIMES,
        )
        self._info_in = node.listen(
            "sensor_msgs/msg/CameraInfo",
            "stereo/left/camera_info",
            self._on_info,
            qos.SENSOR,
            need=Need.AT_TIMES,
        )
        self._reminder = node.every(_REMIND_EVERY, self._remind)

    def _on_transforms(self, message: Any) -> None:
        for transform in message.transforms:
            self._transforms.add(*transform_from_message(transform))
        self._look()

    def _on_info(self, message: Any) -> None:
        if not self._settings.frames.left_optical:
            self._optical = str(message.header.frame_id)
        self._look()

    def _look(self) -> None:
        try:
            mounting = find_mounting(self._settings, self._transforms, self._optical)
        except CalibrationError:
            return
        for subscription in (self._transforms_in, self._info_in):
            self._node.destroy_subscription(subscription)
        self._node.destroy_timer(self._reminder)
        self._found(mounting)

    def _remind(self) -> None:
        try:
            find_mounting(self._settings, self._transforms, self._optical)
        except CalibrationError as error:
            self._node.get_logger().error(f"not ready: {error}")
