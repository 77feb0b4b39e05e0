"""The way of each frame: in order, with its pose, closed once, whatever happens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from bookkeeper import Bookkeeper

from pipeline_tracker.echoes import Echo, PlacedEcho
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.nodes.frame_flow import ANSWER_WITHIN, BACKWARD, QUEUE, FrameFlow
from pipeline_tracker.nodes.live_clock import LiveClock
from pipeline_tracker.nodes.timeline import Timeline
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import PipeSegment, State, TrackingStatus, VectorizedStereo

SECOND = 1_000_000_000
RIG = StereoRig(Camera(100.0, 100.0, 50.0, 50.0, 100, 100))


def frame(seconds: float, rig: StereoRig = RIG) -> VectorizedStereo:
    empty = np.zeros((0, 4), np.float32)
    thumbnail = np.zeros((12, 12), np.uint8)
    return VectorizedStereo(round(seconds * SECOND), rig, empty, empty, empty, thumbnail, thumbnail)


def answer(seconds: float) -> PipeSegment:
    return PipeSegment.none(round(seconds * SECOND), 0.3)


@dataclass
class FakeTracker:
    """Asks for a recognition of the frames in ``asks``, fails on those in ``fails``."""

    asks: set[float] = field(default_factory=set)
    fails: set[float] = field(default_factory=set)
    reset_counter: int = 0
    begun: list[tuple[float, bool]] = field(default_factory=list)
    open: float | None = None
    heard: list[float] = field(default_factory=list)

    def begin(
        self, frame: VectorizedStereo, pose: Pose | None, echoes: Sequence[PlacedEcho] = ()
    ) -> TrackedFrame | None:
        assert self.open is None
        seconds = frame.stamp_ns / SECOND
        self.heard += [placed.echo.stamp_ns / SECOND for placed in echoes]
        self.begun.append((seconds, pose is not None))
        if seconds in self.fails:
            raise RuntimeError("boom")
        if seconds in self.asks:
            self.open = seconds
            return None
        return self._closed(seconds, State.TRACKING, "")

    def finish(self, recognition: PipeSegment | None, reason: str = "") -> TrackedFrame:
        assert self.open is not None
        seconds, self.open = self.open, None
        state = State.SEARCHING if recognition is None else State.TRACKING
        return self._closed(seconds, state, reason)

    def reset(self, reason: str) -> None:
        assert reason
        self.open = None
        self.reset_counter += 1

    def _closed(self, seconds: float, state: State, reason: str) -> TrackedFrame:
        stamp = round(seconds * SECOND)
        status = TrackingStatus(stamp, state, reason, 0.5, 0.0, self.reset_counter)
        return TrackedFrame(status, None)


class Desk(Bookkeeper):
    """A flow with clocks to turn, and what came out of it."""

    def __init__(self, **options: Any) -> None:
        super().__init__()
        self.now, self.steady = 0, 0.0
        self.tracker = FakeTracker(**options)
        self.closed: list[TrackingStatus] = []
        self.asked: list[float] = []
        self.flow = FrameFlow(
            self.tracker,  # type: ignore[arg-type]
            load_settings(None, ["pipe.diameter=0.6", "pose.wait=0.2", "pose.max_gap=3.0"]),
            LiveClock(lambda: self.now, lambda: self.steady),
            publish=lambda tracked: self.closed.append(tracked.status),
            request=lambda stamp: self.asked.append(stamp / SECOND),
            clerk=self,
            timeline=Timeline(steady=lambda: self.steady),
            steady=lambda: self.steady,
        )

    def pose(self, *seconds: float) -> None:
        for s in seconds:
            self.flow.add_pose(round(s * SECOND), Pose.identity())

    def go(self, seconds: float) -> None:
        """Let real and the node's time pass, polling as the timer does."""
        for _ in range(20):
            self.now += round(seconds * SECOND / 20)
            self.steady += seconds / 20
            self.flow.poll()

    @property
    def stamps(self) -> list[float]:
        return [status.stamp_ns / SECOND for status in self.closed]


def test_a_frame_is_closed_as_soon_as_its_pose_is_there() -> None:
    desk = Desk()
    desk.pose(9.0)
    desk.flow.add_frame(frame(10.0))
    assert desk.flow.busy
    assert not desk.closed
    desk.pose(11.0)
    assert desk.tracker.begun == [(10.0, True)]
    assert desk.stamps == [10.0]
    assert not desk.flow.busy


def test_a_frame_whose_pose_does_not_come_goes_without_after_the_wait() -> None:
    desk = Desk()
    desk.pose(9.0)
    desk.flow.add_frame(frame(10.0))
    desk.go(0.19)
    assert not desk.closed
    desk.go(0.02)
    assert desk.tracker.begun == [(10.0, False)]


def test_a_stopped_clock_does_not_hold_up_a_frame() -> None:
    desk = Desk()
    desk.flow.add_frame(frame(10.0))
    for _ in range(60):
        desk.steady += 0.01
        desk.flow.poll()
    assert desk.stamps == [10.0]


def test_a_pose_is_not_made_up_over_a_gap() -> None:
    desk = Desk()
    desk.pose(8.0, 12.0)
    desk.flow.add_frame(frame(10.0))
    assert desk.tracker.begun == [(10.0, False)]


def test_frames_go_to_the_tracker_in_the_order_of_their_stamps() -> None:
    desk = Desk()
    desk.flow.add_frame(frame(11.0))
    desk.flow.add_frame(frame(10.5))
    desk.pose(10.0, 12.0)
    assert desk.stamps == [10.5, 11.0]


def test_late_and_repeated_frames_are_dropped() -> None:
    desk = Desk()
    desk.pose(9.0, 12.0)
    for seconds in (10.0, 11.0, 11.0, 10.5):
        desk.flow.add_frame(frame(seconds))
    assert desk.stamps == [10.0, 11.0]
    assert desk.drops == ["frame_late_or_repeated"] * 2


def test_while_one_is_recognised_the_next_wait() -> None:
    desk = Desk(asks={10.0})
    desk.pose(9.0, 20.0)
    desk.flow.add_frame(frame(10.0))
    desk.flow.add_frame(frame(11.0))
    assert desk.asked == [10.0]
    assert not desk.closed
    desk.flow.add_recognition(answer(9.0))
    assert not desk.closed
    desk.flow.add_recognition(answer(10.0))
    assert desk.stamps == [10.0, 11.0]
    assert desk.drops == ["answer_not_asked"]


def test_no_answer_closes_the_frame_with_a_reason() -> None:
    desk = Desk(asks={10.0})
    desk.pose(9.0, 20.0)
    desk.flow.add_frame(frame(10.0))
    desk.go(0.9 * ANSWER_WITHIN)
    assert not desk.closed
    desk.go(0.2 * ANSWER_WITHIN)
    assert desk.closed[0].state is State.SEARCHING
    assert "no answer" in desk.closed[0].reason
    # An answer that comes after all is nobody's.
    desk.flow.add_recognition(answer(10.0))
    assert desk.drops == ["recognition_missing", "answer_not_asked"]


def test_a_full_queue_closes_its_oldest_frames_with_a_reason_in_order() -> None:
    desk = Desk(asks={10.0})
    desk.pose(9.0, 100.0)
    for k in range(QUEUE + 4):
        desk.flow.add_frame(frame(10.0 + k))
    assert not desk.closed
    desk.flow.add_recognition(answer(10.0))
    assert desk.stamps == [10.0 + k for k in range(QUEUE + 4)]
    states = [status.state for status in desk.closed]
    assert states == [State.TRACKING] + [State.SEARCHING] * 3 + [State.TRACKING] * QUEUE
    assert all("dropped" in status.reason for status in desk.closed[1:4])
    assert [status.seconds_since_seen for status in desk.closed[1:4]] == [1.0, 2.0, 3.0]
    assert desk.drops == ["frame_queue_full"] * 3


@pytest.mark.parametrize("who", ["pose", "frame", "clock"])
def test_time_going_backward_closes_all_and_resets_once(who: str) -> None:
    desk = Desk(asks={10.0})
    desk.pose(9.0, 20.0)
    desk.flow.add_frame(frame(10.0))
    desk.flow.add_frame(frame(11.0))
    if who == "pose":
        desk.pose(2.0)
    elif who == "frame":
        desk.flow.add_frame(frame(2.0))
    else:
        desk.flow.clock_went_back(2 * SECOND, 18 * SECOND)
    assert desk.stamps[:2] == [10.0, 11.0]
    assert [status.reset_counter for status in desk.closed[:2]] == [0, 0]
    assert all(BACKWARD in status.reason for status in desk.closed[:2])
    assert desk.tracker.reset_counter == 1
    # What was under way is of the past, and the next lap is like the first one.
    if who != "frame":
        desk.flow.add_frame(frame(12.0))
        desk.flow.add_frame(frame(2.0))
        assert desk.drops[-1] == "frame_of_the_past"
    desk.pose(3.0)
    assert desk.stamps[2:] == [2.0]
    assert desk.tracker.reset_counter == desk.closed[-1].reset_counter == 1


def test_a_tracker_that_fails_costs_a_frame_and_a_reset() -> None:
    desk = Desk(fails={10.0})
    desk.pose(9.0, 20.0)
    desk.flow.add_frame(frame(10.0))
    desk.flow.add_frame(frame(11.0))
    assert desk.stamps == [10.0, 11.0]
    assert desk.closed[0].state is State.SEARCHING
    assert desk.closed[0].reason == "internal error: RuntimeError: boom"
    assert [status.reset_counter for status in desk.closed] == [1, 1]


def test_another_calibration_is_a_reset() -> None:
    desk = Desk()
    desk.pose(9.0, 20.0)
    other = StereoRig(Camera(101.0, 100.0, 50.0, 50.0, 100, 100))
    for seconds, rig in ((10.0, RIG), (11.0, other), (12.0, other)):
        desk.flow.add_frame(frame(seconds, rig))
    assert [status.reset_counter for status in desk.closed] == [0, 1, 1]


def heard_at(seconds: float) -> tuple[int, Echo]:
    stamp = round(seconds * SECOND)
    return stamp, Echo(stamp, np.zeros(3), np.array([0.0, 0.0, -1.0]), 2.0, 0.03, 0.0)


def test_a_frame_waits_for_its_echo_as_for_its_pose() -> None:
    desk = Desk()
    desk.pose(9.0)
    desk.flow.add_ping(*heard_at(9.5))
    desk.pose(10.0)
    desk.flow.add_frame(frame(10.0))
    assert desk.closed == []
    desk.flow.add_ping(*heard_at(10.0))
    assert desk.stamps == [10.0]
    assert desk.tracker.heard == [9.5, 10.0]


def test_a_lost_echo_is_waited_for_no_longer_than_a_pose() -> None:
    desk = Desk()
    desk.flow.add_ping(*heard_at(9.5))
    desk.pose(9.0, 10.0)
    desk.flow.add_frame(frame(10.0))
    desk.go(0.15)
    assert desk.closed == []
    desk.go(0.1)
    assert desk.stamps == [10.0]
    assert desk.tracker.heard == [9.5]


def test_a_ping_without_echo_settles_too_and_repeated_ones_are_counted() -> None:
    desk = Desk()
    desk.pose(9.0, 10.0)
    desk.flow.add_ping(10 * SECOND, None)
    desk.flow.add_frame(frame(10.0))
    assert desk.stamps == [10.0]
    assert desk.tracker.heard == []
    desk.flow.add_ping(*heard_at(10.0))
    assert desk.drops == ["range_late_or_repeated"]


def test_a_silent_sounder_is_not_waited_for() -> None:
    desk = Desk()
    desk.flow.add_ping(*heard_at(1.0))
    desk.pose(9.0, 10.0)
    desk.flow.add_frame(frame(10.0))
    assert desk.stamps == [10.0]


def test_every_frame_is_in_the_account_whatever_happens() -> None:
    desk = Desk(asks={10.0, 20.0, 30.0}, fails={2.0})
    given = 0

    def give(*seconds: float) -> None:
        nonlocal given
        for s in seconds:
            given += 1
            desk.flow.add_frame(frame(s))

    desk.pose(9.0, 40.0)
    give(10.0, 10.0, 9.5)
    give(11.0, 12.0)
    desk.flow.reset("deactivated")
    desk.pose(19.0, 40.0)
    give(20.0, *(21.0 + 0.1 * i for i in range(QUEUE + 3)))
    desk.go(ANSWER_WITHIN + 1.0)
    # A lap later; what is left over of the one before comes in between.
    give(1.0)
    give(30.0)
    give(2.0)
    desk.pose(2.5)
    desk.go(ANSWER_WITHIN + 1.0)
    account = desk.ledger.account()
    assert given == account.processed + account.lost, account
    assert set(account.dropped) >= {"frame_late_or_repeated", "deactivated", "frame_queue_full"}
    assert "internal_error" in account.dropped
    # Each that was taken has its status, those that were dropped while they waited too.
    unseen = account.dropped["frame_late_or_repeated"] + account.dropped.get("frame_of_the_past", 0)
    assert len(desk.closed) == given - unseen
