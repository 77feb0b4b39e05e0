"""Node: a frame without a past to a pipe segment, on request."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from collections.abc import Sequence
from functools import partial
from typing import Any

from pipeline_tracker.diagnostics.inputs import Need
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    request_from_message,
    segment_message,
    stamp_ns,
    vectorized_from_message,
)
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.base import MountedNode
from pipeline_tracker.nodes.lifecycle import Scope
from pipeline_tracker.nodes.process import prepare_transport
from pipeline_tracker.nodes.runtime import run_nodes
from pipeline_tracker.nodes.worker import END_WITHIN, Worker
from pipeline_tracker.pipeline import Stage
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.types import PipeSegment

# Frames kept for requests to come, and requests kept for frames to come.
FRAMES = 10
REQUESTS = 10
# A frame comes soon after its request or not at all, s.
FRAME_WITHIN = 2.0


class LocalRecognizer(MountedNode):
    """Keeps the last few frames and answers each requested stamp with a segment."""

    NAME = "local_recognizer"
    STAGE = Stage.RECOGNITION
    ITEMS = "requests"

    def open_outputs(self) -> None:
        """Open the topic of answers."""
        self._recognition_out = self.speak(
            "pipeline_tracker_msgs/msg/PipeSegment", "pipeline/recognition"
        )
        self._frames: OrderedDict[int, Any] = OrderedDict()
        self._requests: OrderedDict[int, float] = OrderedDict()

    def start_mounted(self, mounting: Pose) -> None:
        """Open the topics of frames and requests."""
        self._recognizer = Recognizer(self.settings, mounting)
        recognize = partial(self._recognize, self.scope)
        self._worker: Worker[Any] = Worker(recognize, REQUESTS, self._on_overrun, self.NAME)
        self.scope.add(self._worker.close, END_WITHIN)
        self.listen(
            "pipeline_tracker_msgs/msg/VectorizedStereo",
            "pipeline/vectorized",
            self._on_frame,
            qos.PIPELINE,
        )
        self.listen(
            "std_msgs/msg/Header",
            "pipeline/recognition_request",
            self._on_request,
            qos.PIPELINE,
            request_from_message,
            Need.AT_TIMES,
            counted=True,
        )
        self.ready()

    def stop(self) -> None:
        """Forget frames and requests."""
        if hasattr(self, "_worker"):
            self._forget("deactivated")

    def change(self) -> None:
        """Go on with other settings."""
        self._recognizer.change(self.settings)

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:  # noqa: ARG002 - no matter
        """Forget frames and requests."""
        if hasattr(self, "_worker"):
            self._forget("time_went_backward")

    def _forget(self, reason: str) -> None:
        held = len(self._requests) + len(self._worker.clear())
        self._frames.clear()
        self._requests.clear()
        if held:
            self.dropped(reason, f"{held} requests of before", held)

    def _on_frame(self, message: Any) -> None:
        stamp = stamp_ns(message.header)
        self._frames.pop(stamp, None)
        self._frames[stamp] = message
        if len(self._frames) > FRAMES:
            self._frames.popitem(last=False)
        asked = self._requests.pop(stamp, None)
        if asked is None:
            return
        if time.monotonic() - asked <= FRAME_WITHIN:
            self._worker.put(message)
        else:
            self.dropped("request_without_frame", f"stamp {stamp} ns: it came too late", 1)

    def _on_request(self, stamp: int) -> None:
        if stamp in self._frames:
            self._worker.put(self._frames[stamp])
            return
        if self._requests.pop(stamp, None) is not None:
            self.dropped("request_repeated", f"stamp {stamp} ns", 1)
        # The request may overtake the frame.
        self._requests[stamp] = time.monotonic()
        if len(self._requests) > REQUESTS:
            lost, _ = self._requests.popitem(last=False)
            self.dropped("request_without_frame", f"stamp {lost} ns", 1)

    def _on_overrun(self, message: Any) -> None:
        stamp = stamp_ns(message.header)
        words = f"frame of {stamp} ns: requests come faster than they are answered"
        self.dropped("overrun", words, 1)

    def _recognize(self, scope: Scope, message: Any) -> None:
        """Recognise a frame and publish the answer; in the computing thread."""
        stamp = stamp_ns(message.header)
        try:
            segment = self._recognizer.recognize(vectorized_from_message(message))
        except Exception as error:  # noqa: BLE001 - the tracker waits for an answer all the same
            self.refused("frame", error)
            segment = PipeSegment.none(stamp, self.settings.radius)
        # The node may have been deactivated meanwhile.
        if not scope.is_open:
            self.dropped("deactivated", f"request of {stamp} ns", 1)
            return
        try:
            self._answer(segment)
        except PipelineTrackerError as error:
            self.refused("answer", error)
            self._answer(PipeSegment.none(stamp, self.settings.radius))
        self.answered(stamp)

    def _answer(self, segment: PipeSegment) -> None:
        self._recognition_out.publish(
            segment_message(self.messages, segment, self.settings.frames.base_link)
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    prepare_transport(local=False)
    return run_nodes([LocalRecognizer], args)


if __name__ == "__main__":
    sys.exit(main())
