"""Status, segment and poses put together; silence noticed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bookkeeper import Bookkeeper

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.nodes.live_clock import LiveClock
from pipeline_tracker.nodes.state_flow import (
    QUEUE,
    SEGMENT_WITHIN,
    FrameState,
    OutputWatch,
    StateFlow,
)
from pipeline_tracker.nodes.timeline import Timeline
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.types import Contours, Mode, PipeSegment, State, TrackingStatus

SECOND = 1_000_000_000
SETTINGS = load_settings(None, ["pipe.diameter=0.6", "pose.wait=0.2"])


def status(seconds: float, state: State = State.TRACKING, counter: int = 0) -> TrackingStatus:
    return TrackingStatus(round(seconds * SECOND), state, "", 0.5, 0.0, counter)


def segment(seconds: float) -> PipeSegment:
    return PipeSegment(
        round(seconds * SECOND),
        Mode.TRACKING,
        0,
        np.array([-0.25, 0.0, -2.3]),
        np.array([0.25, 0.0, -2.3]),
        0.3,
        np.diag([1e-4, 1e-4, 1e-4, 1e-4]),
        0.5,
        Contours.LEFT_IMAGE_LEFT,
        np.zeros((1, 4), np.float32),
    )


class Desk(Bookkeeper):
    """A flow with clocks to turn, and what came out of it."""

    def __init__(self) -> None:
        super().__init__()
        self.now, self.steady = 0, 0.0
        self.clock = LiveClock(lambda: self.now, lambda: self.steady)
        self.out: list[FrameState] = []
        self.flow = StateFlow(
            RelativeStateEstimator(SETTINGS, Pose.identity()),
            SETTINGS,
            self.clock,
            publish=self.out.append,
            clerk=self,
            timeline=Timeline(steady=lambda: self.steady),
        )

    def pose(self, *seconds: float) -> None:
        for s in seconds:
            position = np.array([0.3 * s, 0.0, 0.0])
            self.flow.add_pose(round(s * SECOND), Pose(np.eye(3), position))

    def go(self, seconds: float) -> None:
        for _ in range(20):
            self.now += round(seconds * SECOND / 20)
            self.steady += seconds / 20
            self.flow.poll()

    @property
    def stamps(self) -> list[float]:
        return [frame.state.stamp_ns / SECOND for frame in self.out]


@pytest.mark.parametrize("order", ["segment first", "status first", "pose last"])
def test_the_order_of_arrival_does_not_matter(order: str) -> None:
    desk = Desk()
    desk.pose(9.0)
    if order == "segment first":
        desk.pose(10.0)
        desk.flow.add_segment(segment(10.0))
        desk.flow.add_status(status(10.0))
    elif order == "status first":
        desk.pose(10.0)
        desk.flow.add_status(status(10.0))
        assert not desk.out
        desk.flow.add_segment(segment(10.0))
    else:
        desk.flow.add_segment(segment(10.0))
        desk.flow.add_status(status(10.0))
        assert not desk.out
        desk.pose(10.0)
    (frame,) = desk.out
    assert frame.state.valid
    assert frame.state.motion_observed
    assert frame.state.min_distance == pytest.approx(2.0)
    assert frame.pose is not None


def test_a_pose_that_does_not_come_is_done_without() -> None:
    desk = Desk()
    desk.flow.add_segment(segment(10.0))
    desk.flow.add_status(status(10.0))
    desk.go(0.25)
    (frame,) = desk.out
    assert frame.state.valid
    assert not frame.state.motion_observed


def test_a_frame_that_was_tracked_without_a_pose_stands_alone() -> None:
    desk = Desk()
    desk.pose(*(0.5 * k for k in range(40)))
    desk.flow.add_segment(segment(10.0))
    desk.flow.add_status(replace(status(10.0), reason="no_pose"))
    # Nor is a pose waited for.
    desk.flow.add_segment(segment(100.0))
    desk.flow.add_status(replace(status(100.0), reason="no_pose"))
    assert desk.stamps == [10.0, 100.0]
    assert all(frame.state.valid for frame in desk.out)
    assert not any(frame.state.motion_observed for frame in desk.out)


def test_an_estimator_that_fails_costs_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = Desk()
    desk.pose(9.0, 20.0)

    def fail(*_: object) -> None:
        raise RuntimeError("boom")

    desk.flow.add_segment(segment(10.0))
    with monkeypatch.context() as patch:
        patch.setattr(RelativeStateEstimator, "update", fail)
        desk.flow.add_status(status(10.0))
    desk.flow.add_segment(segment(11.0))
    desk.flow.add_status(status(11.0))
    assert [frame.state.valid for frame in desk.out] == [False, True]
    assert desk.drops == ["internal_error"]


def test_a_segment_that_does_not_come_makes_the_state_invalid() -> None:
    desk = Desk()
    desk.pose(9.0, 10.0)
    desk.flow.add_status(status(10.0))
    desk.flow.add_status(status(11.0, State.SEARCHING))
    desk.go(0.9 * SEGMENT_WITHIN)
    assert not desk.out
    desk.go(0.2 * SEGMENT_WITHIN)
    assert desk.stamps == [10.0, 11.0]
    assert not desk.out[0].state.valid
    assert desk.drops == ["segment_missing"]


def test_what_waits_is_bounded() -> None:
    desk = Desk()
    desk.pose(9.0, 100.0)
    for k in range(QUEUE + 3):
        desk.flow.add_status(status(10.0 + k))
    assert desk.stamps == [10.0, 11.0, 12.0]
    for k in range(QUEUE + 2):
        desk.flow.add_segment(segment(200.0 + k))
    assert desk.drops.count("segment_without_status") == 2


def test_another_reset_counter_forgets_the_past() -> None:
    desk = Desk()
    desk.pose(*(0.5 * k for k in range(40)))
    for k in range(3):
        desk.flow.add_segment(segment(10.0 + k))
        desk.flow.add_status(status(10.0 + k))
    assert desk.out[-1].state.chainage == pytest.approx(0.6)
    desk.flow.add_segment(segment(13.0))
    desk.flow.add_status(status(13.0, counter=1))
    assert desk.out[-1].state.chainage == 0.0
    assert desk.out[-1].state.reset_counter == 1


def test_a_status_that_comes_again_or_late_gives_no_second_state() -> None:
    desk = Desk()
    desk.pose(9.0, 20.0)
    for stamp in (10.0, 11.0, 11.0, 10.5, 12.0):
        desk.flow.add_status(status(stamp, State.SEARCHING))
    assert desk.stamps == [10.0, 11.0, 12.0]
    assert desk.drops == ["status_late_or_repeated"] * 2


def test_chainage_is_counted_from_a_reference_point() -> None:
    desk = Desk()
    assert not desk.flow.set_reference()
    desk.pose(*(0.5 * k for k in range(40)))

    def drive(*stamps: float) -> list[float]:
        for stamp in stamps:
            desk.flow.add_segment(segment(stamp))
            desk.flow.add_status(status(stamp))
        return [out.state.chainage for out in desk.out[-len(stamps) :]]

    assert drive(10.0, 11.0, 12.0) == pytest.approx([0.0, 0.3, 0.6])
    assert desk.flow.set_reference()
    assert drive(13.0, 14.0) == pytest.approx([0.3, 0.6])
    assert {out.state.reset_counter for out in desk.out} == {0}


@pytest.mark.parametrize("who", ["pose", "clock"])
def test_the_lap_after_a_step_back_is_like_the_first(who: str) -> None:
    desk = Desk()
    for lap in range(2):
        if lap and who == "clock":
            desk.flow.clock_went_back(9 * SECOND, 5 * SECOND)
            # Left over from before: neither old poses nor an old status are used.
            desk.pose(13.0)
            desk.flow.add_status(status(12.5, State.SEARCHING))
        desk.pose(9.0, 10.0, 11.0, 12.0)
        for k in range(3):
            desk.flow.add_segment(segment(10.0 + k))
            desk.flow.add_status(status(10.0 + k, counter=lap))
    assert desk.stamps == [10.0, 11.0, 12.0] * 2
    for one, other in zip(desk.out[:3], desk.out[3:], strict=True):
        assert replace(other.state, reset_counter=0, upper_point=0, upper_point_vertical=0) == (
            replace(one.state, upper_point=0, upper_point_vertical=0)
        )
        np.testing.assert_array_equal(one.state.upper_point, other.state.upper_point)


class TestOutputWatch:
    def run(self, desk: Desk, watch: OutputWatch, seconds: float) -> list[float]:
        """Poll every 50 ms and return when a state was due, by the steady clock."""
        due = []
        for _ in range(round(seconds / 0.05)):
            desk.now += SECOND // 20
            desk.steady += 0.05
            if watch.due(0.05) is not None:
                due.append(round(desk.steady, 2))
        return due

    def test_due_within_the_timeout_and_then_each_second(self) -> None:
        desk = Desk()
        watch = OutputWatch(2.0, desk.clock)
        assert self.run(desk, watch, 5.0) == pytest.approx([1.95, 2.95, 3.95, 4.95], abs=0.051)

    def test_a_frame_begins_the_count_anew(self) -> None:
        desk = Desk()
        watch = OutputWatch(1.0, desk.clock)
        assert not self.run(desk, watch, 0.9)
        watch.heard(SECOND)
        assert not self.run(desk, watch, 0.9)
        assert self.run(desk, watch, 0.2)

    def test_by_default_three_periods_and_at_least_half_a_second(self) -> None:
        watch = OutputWatch(0.0, Desk().clock)
        assert watch.timeout == 0.5
        for k in range(4):
            watch.heard(k * SECOND // 10)
        assert watch.timeout == 0.5
        for k in range(10, 20):
            watch.heard(2 * k * SECOND)
        assert watch.timeout == pytest.approx(6.0)
        # One image that is missing does not change the period.
        watch.heard(48 * SECOND)
        assert watch.timeout == pytest.approx(6.0)
        # After a step back the period is not known.
        watch.heard(SECOND)
        assert watch.timeout == 0.5

    def test_a_stopped_clock_does_not_hide_the_silence(self) -> None:
        desk = Desk()
        watch = OutputWatch(1.0, desk.clock, simulated=True)
        watch.heard(desk.now)
        stamps = []
        for _ in range(60):
            desk.steady += 0.05
            stamp = watch.due(0.05)
            if stamp is not None:
                stamps.append((round(desk.steady, 2), stamp))
        assert [when for when, _ in stamps] == pytest.approx([0.95, 1.95, 2.95], abs=0.051)
        # Never the stamp of a frame.
        assert {stamp for _, stamp in stamps} == {desk.now + 1}

    def test_a_clock_that_stops_does_not_make_a_short_timeout_longer(self) -> None:
        desk = Desk()
        watch = OutputWatch(0.3, desk.clock, simulated=True)
        watch.heard(desk.now)
        due = []
        for _ in range(6):
            desk.steady += 0.05
            if watch.due(0.05) is not None:
                due.append(round(desk.steady, 2))
        assert due == pytest.approx([0.25], abs=0.051)

    def test_the_age_of_a_frame_counts(self) -> None:
        desk = Desk()
        watch = OutputWatch(1.0, desk.clock)
        assert watch.heard(desk.now, age=0.6)
        assert self.run(desk, watch, 1.0) == pytest.approx([0.35], abs=0.051)

    def test_a_frame_that_is_too_late_is_said_not_to_be_valid_and_that_is_enough(self) -> None:
        desk = Desk()
        watch = OutputWatch(1.0, desk.clock)
        assert not watch.heard(desk.now, age=1.1)
        assert self.run(desk, watch, 1.5) == pytest.approx([1.0], abs=0.051)

    def test_another_timeout_counts_from_the_last_frame(self) -> None:
        desk = Desk()
        watch = OutputWatch(10.0, desk.clock)
        assert not self.run(desk, watch, 2.0)
        watch.change(1.0)
        assert self.run(desk, watch, 0.1)
