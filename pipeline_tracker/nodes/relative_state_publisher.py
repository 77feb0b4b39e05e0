"""Node: status, segment and poses to what the autopilot needs."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.diagnostics.levels import Report
from pipeline_tracker.diagnostics.overall import Overall
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.markers import Centerline, markers_message
from pipeline_tracker.messages import (
    float_message,
    relative_state_message,
    segment_from_message,
    status_from_message,
)
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.base import MountedNode
from pipeline_tracker.nodes.diagnostics import DiagnosticsListener, overall_name, status_name
from pipeline_tracker.nodes.launcher import MODULES
from pipeline_tracker.nodes.process import prepare_transport
from pipeline_tracker.nodes.runtime import run_nodes
from pipeline_tracker.nodes.state_flow import FrameState, OutputWatch, StateFlow
from pipeline_tracker.nodes.timeline import StampJudge
from pipeline_tracker.pipeline import Stage
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.types import RelativeState

# How often waiting frames and the output's silence are looked at, s.
_POLL = 0.05

# Single numbers, each with the variance that says whether it is known.
_NUMBERS = {
    "heading_misalignment": "heading_variance",
    "pitch_misalignment": "pitch_variance",
    "approach_speed": "speed_variance",
    "min_distance": "distance_variance",
}


class RelativeStatePublisher(MountedNode):
    """Gives one relative state for each status, and a state "not valid" when none comes."""

    NAME = "relative_state_publisher"
    STAGE = Stage.RELATIVE_STATE
    ITEMS = "statuses"

    def __init__(self, parameters: Mapping[str, Any] | None = None, **options: Any) -> None:
        """Make the node; see ``PipelineNode``."""
        super().__init__(parameters, **options)
        self._reset_counter = 0
        namespace = self.get_namespace()
        self._overall = Overall(
            overall_name(namespace), [status_name(namespace, name) for name in MODULES]
        )
        self._others = DiagnosticsListener(self, self._overall.hear)
        # How often this node itself has forgotten the past: it counts as a reset too.
        self._resets = 0

    def reports(self) -> Iterable[Report]:
        """Return this node's health, and that of all nodes together."""
        return [*super().reports(), self._overall.report()]

    def open_outputs(self) -> None:
        """Open the topics for the autopilot and for viewers, and the operator's service."""
        self._state_out = self.speak(
            "pipeline_tracker_msgs/msg/RelativeState", "pipeline/relative_state"
        )
        self._numbers_out = {
            name: self.speak("std_msgs/msg/Float64", f"pipeline/{name}") for name in _NUMBERS
        }
        self._centerline_out = self.speak("nav_msgs/msg/Path", "pipeline/centerline")
        self._markers_out = self.speak("visualization_msgs/msg/MarkerArray", "pipeline/markers")
        self.serve("~/set_reference", self._set_reference)

    def start_mounted(self, mounting: Pose) -> None:
        """Open the topics of segments, statuses and poses."""
        settings = self.settings
        self._frames = settings.frames
        self._centerline = Centerline()
        self._watch = OutputWatch(
            settings.output.timeout, self.live_clock, simulated=settings.use_sim_time
        )
        self._ages = StampJudge(self.live_clock)
        self._flow = StateFlow(
            RelativeStateEstimator(settings, mounting),
            settings,
            self.live_clock,
            publish=self._publish,
            clerk=self,
            timeline=self.timeline(),
        )
        self.listen_to_poses(self._flow.add_pose)
        self.listen(
            "pipeline_tracker_msgs/msg/PipeSegment",
            "pipeline/segment",
            self._flow.add_segment,
            qos.PIPELINE,
            segment_from_message,
            Need.AT_TIMES,
        )
        self.listen(
            "pipeline_tracker_msgs/msg/TrackingStatus",
            "pipeline/status",
            self._flow.add_status,
            qos.PIPELINE,
            status_from_message,
            counted=True,
        )
        self._timer = self.every(_POLL, self._poll)
        self.ready()

    def stop(self) -> None:
        """Forget the past; direction of travel, side and chainage start anew."""
        if hasattr(self, "_flow"):
            self._flow.forget("deactivated")
            self._resets += 1
            self._reset_counter += 1
            del self._flow, self._watch, self._centerline

    def change(self) -> None:
        """Go on with other settings."""
        self._flow.change(self.settings)
        self._watch.change(self.settings.output.timeout)

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget the past."""
        if hasattr(self, "_flow"):
            self._flow.clock_went_back(now_ns, way_ns)
            self._watch.restart()

    def _set_reference(self) -> str:
        """Answer the operator's request to count the chainage from here."""
        self.require_ready("set_reference")
        here = self._flow.set_reference()
        return "chainage 0 is " + ("here" if here else "where the pipe is seen next")

    def _poll(self) -> None:
        self._flow.poll()
        stamp = self._watch.due(_POLL)
        if stamp is not None:
            self._send(RelativeState(stamp, False, 0.0, self._reset_counter))

    def _publish(self, frame: FrameState) -> None:
        counter = frame.state.reset_counter + self._resets
        state = replace(frame.state, reset_counter=counter)
        self._reset_counter = state.reset_counter
        if not self._watch.heard(state.stamp_ns, self._age(state.stamp_ns)):
            self.dropped("state_too_late", f"image of {state.stamp_ns} ns: not valid any more")
            state = replace(state, valid=False, quality=0.0)
        self._send(state)
        try:
            self._show(frame, state)
        except PipelineTrackerError as error:
            # The autopilot has got its state: what is missing is only to be looked at.
            self.refused("view", error)

    def _show(self, frame: FrameState, state: RelativeState) -> None:
        """Publish the single numbers and what viewers draw."""
        if state.valid:
            for name, variance in _NUMBERS.items():
                # An unknown number is 0, which a reader of the number alone would take for one.
                if getattr(state, variance) >= 0.0:
                    number = float_message(self.messages, getattr(state, name))
                    self._numbers_out[name].publish(number)
        if self._centerline.update(state, frame.segment, frame.pose):
            self._centerline_out.publish(
                self._centerline.message(self.messages, state.stamp_ns, self._frames.odom)
            )
        self._markers_out.publish(
            markers_message(
                self.messages, frame.status, frame.segment, state, self._frames.base_link
            )
        )

    def _age(self, stamp_ns: int) -> float:
        """Time since an image was taken, s; 0 where its stamp is not of this machine's clock."""
        # Simulated time may run faster than the machine computes: late there is not late here.
        age = None if self.settings.use_sim_time else self._ages.age("image", stamp_ns)
        return max(0.0, age or 0.0)

    def _send(self, state: RelativeState) -> None:
        self._state_out.publish(
            relative_state_message(self.messages, state, self._frames.base_link)
        )
        self._overall.published(valid=state.valid)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    prepare_transport(local=False)
    return run_nodes([RelativeStatePublisher], args)


if __name__ == "__main__":
    sys.exit(main())
