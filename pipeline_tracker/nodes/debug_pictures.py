"""Pictures of what the nodes find, drawn only while someone looks at them."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.errors import CalibrationError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    header_message,
    relative_state_from_message,
    segment_from_message,
    stamp_ns,
    status_from_message,
    transform_from_message,
)
from pipeline_tracker.mounting import StaticTransforms, find_mounting
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.mounting import mounting_of_settings
from pipeline_tracker.nodes.worker import END_WITHIN, Worker
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.report.overlay import draw_overlay
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import (
    Image,
    PipeSegment,
    RelativeState,
    State,
    TrackingStatus,
    VectorizedStereo,
)

if TYPE_CHECKING:
    from pipeline_tracker.nodes.base import PipelineNode

TOPIC = "pipeline/debug/image/compressed"
# Whether someone looks is asked this often, s.
_LOOK_EVERY = 0.5
# Frames that wait for what the other nodes say of them.
_KEPT = 6
_WIDTH, _JPEG_QUALITY = 1280, 80
# The drawing thread gives way to those that compute.
_NICE = 10


@dataclass
class _Kept:
    """A frame, and what has come of it so far."""

    frame_id: str
    left: Image
    right: Image | None
    vectorized: VectorizedStereo
    status: TrackingStatus | None = None
    segment: PipeSegment | None = None
    state: RelativeState | None = None

    @property
    def is_whole(self) -> bool:
        if self.status is None or self.state is None:
            return False
        return self.status.state == State.SEARCHING or self.segment is not None


class DebugPictures:
    """Draws the results on the images and publishes them; costs nothing while nobody looks.

    It lives in the node that has the images, and listens to what the others say of them. Where
    pictures come faster than they are drawn the older ones are dropped.
    """

    def __init__(self, node: PipelineNode) -> None:
        """Open the topic of the pictures.

        Args:
            node: the node that has the images, being configured.
        """
        self._node = node
        self._out = node.speak("sensor_msgs/msg/CompressedImage", TOPIC)
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, _Kept] = OrderedDict()
        self._inputs: list[Any] = []
        self._wanted = False

    def start(self) -> None:
        """Look out for those who want pictures; the node is being activated."""
        try:
            self._mounting = mounting_of_settings(self._node.settings)
        except CalibrationError:
            # The contours are drawn without it.
            self._mounting = None
        self._transforms = StaticTransforms()
        self._worker: Worker[_Kept] = Worker(self._draw, 1, _drop, "debug_pictures")
        self._is_nice = False
        self._node.scope.add(self._worker.close, END_WITHIN)
        self._node.scope.add(self._close_inputs)
        self._node.every(_LOOK_EVERY, self._look)

    def take(
        self, frame_id: str, left: Image, right: Image | None, vectorized: VectorizedStereo
    ) -> None:
        """Keep a frame until the other nodes have answered; from any thread.

        Args:
            frame_id: the left optical frame.
            left, right: its images, (H, W) uint8; right None in mono.
            vectorized: what was published of them.
        """
        if not self._wanted:
            return
        with self._lock:
            self._kept[vectorized.stamp_ns] = _Kept(frame_id, left, right, vectorized)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)

    def forget(self) -> None:
        """Drop all frames that wait."""
        with self._lock:
            self._kept.clear()

    def _look(self) -> None:
        """Open or close the inputs as someone begins or ends to look."""
        self._wanted = self._out.get_subscription_count() > 0
        if self._wanted and not self._inputs:
            self._open_inputs()
        elif not self._wanted and self._inputs:
            self._close_inputs()

    def _open_inputs(self) -> None:
        listen, package = self._node.listen, "pipeline_tracker_msgs/msg"
        for kind, topic, take in (
            ("PipeSegment", "pipeline/segment", self._on_segment),
            ("TrackingStatus", "pipeline/status", self._on_status),
            ("RelativeState", "pipeline/relative_state", self._on_state),
        ):
            subscription = listen(
                f"{package}/{kind}", topic, take, qos.PIPELINE, need=Need.AT_TIMES
            )
            self._inputs.append(subscription)
        if self._mounting is None and find_spec("tf2_msgs") is not None:
            kind, topic = "tf2_msgs/msg/TFMessage", "/tf_static"
            subscription = listen(
                kind, topic, self._on_transforms, qos.STATIC_TRANSFORM, need=Need.AT_TIMES
            )
            self._inputs.append(subscription)

    def _close_inputs(self) -> None:
        self._wanted = False
        for subscription in self._inputs:
            self._node.destroy_subscription(subscription)
        self._inputs.clear()
        self.forget()

    def _on_segment(self, message: Any) -> None:
        self._add(stamp_ns(message.header), "segment", segment_from_message(message))

    def _on_status(self, message: Any) -> None:
        self._add(stamp_ns(message.header), "status", status_from_message(message))

    def _on_state(self, message: Any) -> None:
        self._add(stamp_ns(message.header), "state", relative_state_from_message(message))

    def _on_transforms(self, message: Any) -> None:
        for transform in message.transforms:
            self._transforms.add(*transform_from_message(transform))

    def _add(self, stamp: int, name: str, part: Any) -> None:
        with self._lock:
            kept = self._kept.get(stamp)
            if kept is None:
                return
            setattr(kept, name, part)
            if not kept.is_whole:
                return
            del self._kept[stamp]
        self._worker.put(kept)

    def _draw(self, kept: _Kept) -> None:
        """Draw and publish a picture; in the drawing thread."""
        if not self._is_nice:
            # On Linux it is the priority of the thread alone.
            with suppress(OSError, AttributeError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
            self._is_nice = True
        try:
            self._out.publish(self._message(kept))
        except Exception as error:  # noqa: BLE001 - a picture is lost, not the node
            self._node.refused("picture", error)

    def _message(self, kept: _Kept) -> Any:
        assert kept.status is not None  # noqa: S101 - it is whole
        assert kept.state is not None  # noqa: S101
        tracked = TrackedFrame(kept.status, kept.segment)
        result = FrameResult(kept.vectorized, None, tracked, kept.state)
        mounting = self._mounting or self._found_mounting(kept.frame_id)
        picture = draw_overlay(kept.left, kept.right, result, mounting, max_width=_WIDTH)
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        factory = self._node.messages
        return factory.message(
            "sensor_msgs/msg/CompressedImage",
            header=header_message(factory, kept.vectorized.stamp_ns, kept.frame_id),
            format="jpeg",
            data=factory.sequence(np.asarray(data, dtype=np.uint8).ravel()),
        )

    def _found_mounting(self, frame_id: str) -> Pose | None:
        try:
            return find_mounting(self._node.settings, self._transforms, frame_id)
        except CalibrationError:
            return None


def _drop(_kept: _Kept) -> None:
    """Let a picture go that was not drawn in time."""
