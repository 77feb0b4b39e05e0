"""Node: frames and poses to the tracked segment, and one status for each frame."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.diagnostics.levels import Level
from pipeline_tracker.diagnostics.margin import Margin
from pipeline_tracker.echoes import Echo
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    header_message,
    range_from_message,
    segment_from_message,
    segment_message,
    status_message,
    transform_from_message,
    vectorized_from_message,
)
from pipeline_tracker.mounting import StaticTransforms, find_beam
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.base import MountedNode
from pipeline_tracker.nodes.frame_flow import DEACTIVATED, FrameFlow
from pipeline_tracker.nodes.process import prepare_transport
from pipeline_tracker.nodes.runtime import run_nodes
from pipeline_tracker.pipeline import Stage
from pipeline_tracker.self_check import SelfCheck
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import State, VectorizedStereo

# How often waiting frames are looked at, s.
_POLL = 0.02


class PipeTracker(MountedNode):
    """Tracks in the executor's thread: 20 ms a frame, and poses meanwhile wait in their queue."""

    NAME = "pipe_tracker"
    STAGE = Stage.TRACKING

    def __init__(self, parameters: Mapping[str, Any] | None = None, **options: Any) -> None:
        """Make the node; see ``PipelineNode``."""
        super().__init__(parameters, **options)
        self._resets = 0

    def open_outputs(self) -> None:
        """Open the topics of segments, statuses and requests, and the operator's service."""
        self._segment_out = self.speak("pipeline_tracker_msgs/msg/PipeSegment", "pipeline/segment")
        self._status_out = self.speak("pipeline_tracker_msgs/msg/TrackingStatus", "pipeline/status")
        self._request_out = self.speak("std_msgs/msg/Header", "pipeline/recognition_request")
        self.serve("~/reset", self._reset)

    def start_mounted(self, mounting: Pose) -> None:
        """Open the topics of frames, poses and answers."""
        self._base_link = self.settings.frames.base_link
        self._optical = ""
        self._flow = FrameFlow(
            Tracker(self.settings, mounting, self.settings.recognition.only, self._resets),
            self.settings,
            self.live_clock,
            publish=self._publish,
            request=self._ask,
            clerk=self,
            timeline=self.timeline(),
        )
        self._margin = Margin(self.settings.motion.min_overlap)
        self._vectorization = 0.0
        self._check = SelfCheck(self.settings, mounting)
        self._timer = self.every(_POLL, self._poll)
        self._timer.cancel()
        self.listen_to_poses(self._flow.add_pose)
        if self.settings.mode == "mono":
            self._listen_to_ranges()
        self.listen(
            "pipeline_tracker_msgs/msg/PipeSegment",
            "pipeline/recognition",
            self._flow.add_recognition,
            qos.PIPELINE,
            segment_from_message,
            Need.AT_TIMES,
        )
        self.listen(
            "pipeline_tracker_msgs/msg/VectorizedStereo",
            "pipeline/vectorized",
            self._on_frame,
            qos.PIPELINE,
            _frame_of,
            counted=True,
        )
        self.ready()

    def stop(self) -> None:
        """Close all frames and forget pipe and poses; the reset counter goes on."""
        if hasattr(self, "_flow"):
            self._flow.reset(DEACTIVATED)
            self._resets = self._flow.reset_counter
            del self._flow

    def change(self) -> None:
        """Go on with other settings."""
        self._flow.change(self.settings)

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget pipe, poses and frames."""
        if hasattr(self, "_flow"):
            self._flow.clock_went_back(now_ns, way_ns)

    def _reset(self) -> str:
        """Answer the operator's request to forget this pipe and search again."""
        self.require_ready("reset")
        self._flow.search_again()
        return f"the pipe is forgotten and searched for again, reset {self._flow.reset_counter}"

    def _on_frame(self, given: tuple[str, VectorizedStereo]) -> None:
        self._optical, frame = given
        self._vectorization = frame.processing_time
        self._flow.add_frame(frame)
        # The timer runs only while something waits.
        if self._flow.busy and self._timer.is_canceled():
            self._timer.reset()

    def _listen_to_ranges(self) -> None:
        self._transforms = StaticTransforms()
        if find_spec("tf2_msgs") is not None:
            self.listen(
                "tf2_msgs/msg/TFMessage",
                "/tf_static",
                self._on_transforms,
                qos.STATIC_TRANSFORM,
                need=Need.AT_TIMES,
            )
        self.listen(
            "sensor_msgs/msg/Range",
            "altimeter/range",
            self._on_range,
            qos.SENSOR,
            need=Need.WANTED,
        )

    def _on_transforms(self, message: Any) -> None:
        for transform in message.transforms:
            self._transforms.add(*transform_from_message(transform))

    def _on_range(self, message: Any) -> None:
        stamp, distance, half_angle, sigma = range_from_message(message)
        echo = None
        if distance is not None:
            beam = find_beam(self.settings, self._transforms, str(message.header.frame_id))
            sigma = max(self.settings.altimeter.sigma, sigma)
            echo = Echo(stamp, *beam, distance, sigma, half_angle)
        self._flow.add_ping(stamp, echo)

    def _poll(self) -> None:
        self._flow.poll()
        if not self._flow.busy:
            self._timer.cancel()

    def _ask(self, stamp_ns: int) -> None:
        self._request_out.publish(header_message(self.messages, stamp_ns, self._optical))

    def _publish(self, tracked: TrackedFrame) -> None:
        for warning in tracked.warnings:
            self.get_logger().warning(warning)
        if tracked.segment is not None:
            self._segment_out.publish(
                segment_message(self.messages, tracked.segment, self._base_link)
            )
        self._status_out.publish(status_message(self.messages, tracked.status, self._base_link))
        self._tell(tracked)
        self._watch(tracked)

    def _tell(self, tracked: TrackedFrame) -> None:
        """Put what became of a frame into the node's report."""
        status = tracked.status
        state = status.state.name.lower()
        level = Level.OK if status.state is State.TRACKING else Level.WARN
        why = status.reason or "nothing amiss"
        spent = f"vectorized in {1e3 * self._vectorization:.1f} ms, tracked in "
        spent += f"{1e3 * status.processing_time:.1f} ms"
        self.debug(f"{status.stamp_ns} ns: {state} ({why}), {spent}")
        self.health.note("tracking", state, level, f"{state} ({why})")
        self.health.note("reason", status.reason)
        self.health.note("reset counter", str(status.reset_counter))
        used = self._vectorization + status.processing_time
        self._margin.see(tracked.overlap, tracked.allowed, used)
        self._margin.tell(self.health.note)

    def _watch(self, tracked: TrackedFrame) -> None:
        """Check the user's numbers by a frame that is out already: nobody waits for it."""
        try:
            warnings = self._check.see(tracked)
        except Exception as error:  # noqa: BLE001 - no check may end the node
            self.refused("self_check", error, 0)
            return
        for warning in warnings:
            self.get_logger().warning(warning)


def _frame_of(message: Any) -> tuple[str, VectorizedStereo]:
    return str(message.header.frame_id), vectorized_from_message(message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    prepare_transport(local=False)
    return run_nodes([PipeTracker], args)


if __name__ == "__main__":
    sys.exit(main())
