"""The way of each frame through the tracker: its pose, its recognition, its status."""

from __future__ import annotations

import time
from bisect import insort
from collections.abc import Callable
from dataclasses import dataclass

from pipeline_tracker.echoes import Echo, EchoBuffer
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.nodes.clerk import Clerk
from pipeline_tracker.nodes.live_clock import LiveClock, Mark
from pipeline_tracker.nodes.timeline import Step, Timeline
from pipeline_tracker.settings import Settings
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import PipeSegment, State, TrackingStatus, VectorizedStereo

# Frames that wait while one is recognised; as many as the topic's depth.
QUEUE = 10
# A recognition takes some tenths of a second, on a busy machine some seconds.
ANSWER_WITHIN = 5.0
# An echo sounder that was silent for so long, s, is not waited for.
_SILENT = 5.0

BACKWARD = "time went backward"
RECALIBRATED = "the camera's calibration changed"
DEACTIVATED = "deactivated"
ON_REQUEST = "reset on request"


@dataclass
class _Waiting:
    """A frame in the queue; ``frame`` is None once it had to give way."""

    stamp_ns: int
    frame: VectorizedStereo | None
    since: Mark


@dataclass(frozen=True)
class _Open:
    """The frame that awaits its recognition."""

    stamp_ns: int
    asked: float


class FrameFlow:
    """Gives frames to the tracker in the order of their stamps and closes every one of them.

    A frame waits for its pose, at most ``pose.wait``; then the tracker decides. Where that needs a
    recognition, the frame stays open until the answer comes, at most ``ANSWER_WITHIN`` seconds, and
    the next ones wait. All calls come from one thread.
    """

    def __init__(
        self,
        tracker: Tracker,
        settings: Settings,
        clock: LiveClock,
        publish: Callable[[TrackedFrame], None],
        request: Callable[[int], None],
        clerk: Clerk,
        timeline: Timeline | None = None,
        steady: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without frames.

        Args:
            tracker: the core's tracker.
            settings: ``pose.max_gap`` and ``pose.wait`` are used.
            clock: the node's time.
            publish: called with each closed frame, in the order of the stamps.
            request: called with the stamp (ns) of each frame that needs a recognition.
            clerk: keeps the account of the inputs, a frame being an item of it.
            timeline: notices time going backward.
            steady: a clock that never goes back, s.
        """
        self._tracker = tracker
        self._poses = PoseBuffer(settings.pose.max_gap)
        self._echoes = EchoBuffer()
        self._pose_wait = settings.pose.wait
        self._clock = clock
        self._publish_frame = publish
        self._request = request
        self._clerk = clerk
        self._timeline = timeline or Timeline()
        self._steady = steady
        self._waiting: list[_Waiting] = []
        self._open: _Open | None = None
        self._newest_taken: int | None = None
        self._rig: StereoRig | None = None
        self._last_seen: tuple[int, int] | None = None

    @property
    def reset_counter(self) -> int:
        """How often the tracker has forgotten its past."""
        return self._tracker.reset_counter

    @property
    def busy(self) -> bool:
        """Whether a frame waits for something, so that ``poll`` is needed."""
        return self._open is not None or bool(self._waiting)

    def add_frame(self, frame: VectorizedStereo) -> None:
        """Take in a frame."""
        stamp = frame.stamp_ns
        if not self._goes_on("frame", stamp):
            return
        late = self._newest_taken is not None and stamp <= self._newest_taken
        if late or any(held.stamp_ns == stamp for held in self._waiting):
            self._drop_late("frame", stamp, 1)
            return
        held = _Waiting(stamp, frame, self._clock.mark())
        insort(self._waiting, held, key=lambda w: w.stamp_ns)
        frames = [w for w in self._waiting if w.frame is not None]
        if len(frames) > QUEUE:
            frames[0].frame = None
        self.poll()

    def add_pose(self, stamp_ns: int, pose: Pose) -> None:
        """Take in a pose of base_link in odom."""
        if not self._goes_on("pose", stamp_ns):
            return
        if not self._poses.add(stamp_ns, pose):
            self._drop_late("pose", stamp_ns)
        self.poll()

    def add_ping(self, stamp_ns: int, echo: Echo | None) -> None:
        """Take in a ping of the echo sounder; ``echo`` is None where nothing came back."""
        if not self._goes_on("range", stamp_ns):
            return
        if not self._echoes.add(stamp_ns, echo):
            self._drop_late("range", stamp_ns)
        self.poll()

    def add_recognition(self, segment: PipeSegment) -> None:
        """Take in the recognizer's answer."""
        if self._open is None or self._open.stamp_ns != segment.stamp_ns:
            self._clerk.dropped("answer_not_asked", f"no frame of {segment.stamp_ns} ns awaits it")
            return
        self._finish(segment, "")
        self.poll()

    def clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget everything, the simulated clock has gone back."""
        if self._timeline.clock_went_back(now_ns, way_ns):
            self.reset(BACKWARD)

    def reset(self, reason: str) -> None:
        """Close all frames, forget pipe and poses; the reset counter grows by one."""
        if self._open is not None:
            self._finish(None, reason)
        for held in self._waiting:
            self._clerk.dropped(reason, f"stamp {held.stamp_ns} ns", 1)
            self._close_unseen(held.stamp_ns, f"dropped: {reason}")
        self._waiting.clear()
        self._poses.clear()
        self._echoes.clear()
        self._newest_taken = None
        self._tracker.reset(reason)

    def change(self, settings: Settings) -> None:
        """Go on with another ``pose.wait`` and other limits of the tracker."""
        self._pose_wait = settings.pose.wait
        self._tracker.change(settings)

    def search_again(self) -> None:
        """Forget the pipe, but not the poses; the reset counter grows by one."""
        if self._open is not None:
            # It may hold the very pipe that is to be forgotten.
            self._finish(None, ON_REQUEST)
        self._tracker.reset(ON_REQUEST)
        self.poll()

    def poll(self) -> None:
        """Go on with what has waited long enough; to be called every few tens of ms while busy."""
        if self._open is not None and self._steady() - self._open.asked >= ANSWER_WITHIN:
            self._finish(None, f"no answer of the recognizer within {ANSWER_WITHIN:g} s")
        while self._waiting and self._open is None:
            held = self._waiting[0]
            if held.frame is not None and not self._is_complete(held):
                return
            self._waiting.pop(0)
            self._newest_taken = held.stamp_ns
            if held.frame is None:
                reason = f"dropped: more than {QUEUE} frames waited for the recognizer"
                self._clerk.dropped("frame_queue_full", f"stamp {held.stamp_ns} ns", 1)
                self._close_unseen(held.stamp_ns, reason)
            else:
                self._begin(held.frame)

    def _goes_on(self, kind: str, stamp_ns: int) -> bool:
        """Whether a stamp is to be used; time going back is a reset."""
        step, reason, details = self._timeline.refusal(kind, stamp_ns)
        if reason:
            self._clerk.dropped(reason, details, int(kind == "frame"))
        if step is Step.BACKWARD:
            self.reset(BACKWARD)
        return not reason

    def _is_complete(self, held: _Waiting) -> bool:
        """Whether the frame's pose and echo have come, or have been waited for long enough."""
        stamp = held.stamp_ns
        heard = self._echoes.settled(stamp) or self._echoes.silent_for(stamp, _SILENT)
        if self._poses.settled(stamp) and heard:
            return True
        return self._clock.since(held.since) >= self._pose_wait

    def _begin(self, frame: VectorizedStereo) -> None:
        # Another camera, or one calibrated anew: the past does not fit any more.
        if self._rig is not None and frame.rig != self._rig:
            self._tracker.reset(RECALIBRATED)
        self._rig = frame.rig
        try:
            heard = self._echoes.take(frame.stamp_ns, self._poses)
            tracked = self._tracker.begin(frame, self._poses.at(frame.stamp_ns), heard)
        except Exception as error:  # noqa: BLE001 - no frame may end the node
            self._give_up(frame.stamp_ns, error)
            return
        if tracked is not None:
            self._publish(tracked)
            return
        self._open = _Open(frame.stamp_ns, self._steady())
        self._request(frame.stamp_ns)

    def _finish(self, recognition: PipeSegment | None, reason: str) -> None:
        """Close the open frame."""
        if self._open is None:
            return
        stamp = self._open.stamp_ns
        self._open = None
        if reason:
            self._clerk.dropped("recognition_missing", reason)
        try:
            tracked = self._tracker.finish(recognition, reason)
        except Exception as error:  # noqa: BLE001 - no answer may end the node
            self._give_up(stamp, error)
            return
        self._publish(tracked)

    def _give_up(self, stamp_ns: int, error: Exception) -> None:
        """Close a frame on which the tracker failed, and let it begin anew."""
        reason = f"internal error: {type(error).__name__}: {error}".splitlines()[0]
        self._clerk.dropped("internal_error", reason, 1)
        self._tracker.reset(reason)
        self._close_unseen(stamp_ns, reason)

    def _close_unseen(self, stamp_ns: int, reason: str) -> None:
        """Publish a status for a frame that the tracker has not closed."""
        resets = self._tracker.reset_counter
        unseen = -1.0
        if self._last_seen is not None and self._last_seen[0] == resets:
            unseen = (stamp_ns - self._last_seen[1]) / SECOND_NS
        status = TrackingStatus(stamp_ns, State.SEARCHING, reason, 0.0, unseen, resets)
        self._publish_frame(TrackedFrame(status, None))

    def _publish(self, tracked: TrackedFrame) -> None:
        status = tracked.status
        if status.state is State.TRACKING:
            # What was seen before a reset does not count after it.
            self._last_seen = status.reset_counter, status.stamp_ns
        try:
            self._publish_frame(tracked)
        except PipelineTrackerError as error:
            # Nothing that is not finite goes out, nor is it carried on.
            self._give_up(status.stamp_ns, error)
            return
        self._clerk.answered(status.stamp_ns)

    def _drop_late(self, kind: str, stamp_ns: int, frames: int = 0) -> None:
        words = f"stamp {stamp_ns} ns is not after the last one"
        self._clerk.dropped(f"{kind}_late_or_repeated", words, frames)
