"""Time going backward: noticed once, leftovers recognised, nothing silenced for good."""

from __future__ import annotations

import pytest

from pipeline_tracker.nodes.live_clock import STANDSTILL, LiveClock
from pipeline_tracker.nodes.timeline import StampJudge, Step, Timeline

SECOND = 1_000_000_000


class Clocks:
    def __init__(self) -> None:
        self.now = 0
        self.steady = 0.0

    def timeline(self, *, simulated: bool = False) -> Timeline:
        return Timeline((lambda: self.now) if simulated else None, steady=lambda: self.steady)


def seconds(timeline: Timeline, kind: str, *stamps: float) -> list[Step]:
    return [timeline.see(kind, round(stamp * SECOND)) for stamp in stamps]


def test_time_that_goes_on_is_forward() -> None:
    timeline = Clocks().timeline()
    assert seconds(timeline, "pose", 10, 11, 11, 13) == [Step.FORWARD] * 4
    assert seconds(timeline, "frame", 9, 12) == [Step.FORWARD] * 2


def test_up_to_a_second_backward_is_late_not_a_step() -> None:
    assert seconds(Clocks().timeline(), "pose", 10, 9, 9.5)[1:] == [Step.FORWARD] * 2


def test_the_first_input_to_go_back_is_the_step_and_the_others_follow_it() -> None:
    timeline = Clocks().timeline()
    for kind in ("pose", "frame", "other"):
        seconds(timeline, kind, 100, 101, 102)
    assert seconds(timeline, "pose", 50) == [Step.BACKWARD]
    # What was under way when time went back.
    assert seconds(timeline, "frame", 103, 104) == [Step.PAST] * 2
    assert seconds(timeline, "frame", 50, 51) == [Step.FORWARD] * 2
    assert seconds(timeline, "other", 105) == [Step.PAST]
    assert seconds(timeline, "other", 51) == [Step.FORWARD]


def test_a_step_of_the_clock_is_told_once() -> None:
    clocks = Clocks()
    timeline = clocks.timeline(simulated=True)
    seconds(timeline, "pose", 100, 101)
    clocks.now = 50 * SECOND
    assert timeline.clock_went_back(clocks.now, 52 * SECOND)
    assert seconds(timeline, "pose", 102) == [Step.PAST]
    assert seconds(timeline, "pose", 50) == [Step.FORWARD]


def test_a_clock_that_follows_a_message_backward_is_no_news() -> None:
    clocks = Clocks()
    clocks.now = 101 * SECOND
    timeline = clocks.timeline(simulated=True)
    seconds(timeline, "pose", 100, 101)
    seconds(timeline, "frame", 100)
    assert seconds(timeline, "pose", 50) == [Step.BACKWARD]
    # The clock still shows the time before: a leftover is one all the same.
    assert seconds(timeline, "frame", 101) == [Step.PAST]
    clocks.now = 50 * SECOND
    assert not timeline.clock_went_back(clocks.now, 51 * SECOND)
    assert seconds(timeline, "frame", 101, 50) == [Step.PAST, Step.FORWARD]


def test_each_lap_is_a_step_of_its_own() -> None:
    timeline = Clocks().timeline()
    for lap in range(3):
        first = Step.BACKWARD if lap else Step.FORWARD
        assert seconds(timeline, "pose", 10, 11, 12) == [first, Step.FORWARD, Step.FORWARD]
        assert seconds(timeline, "frame", 10, 11, 12) == [Step.FORWARD] * 3


def test_one_wrong_stamp_of_a_pose_does_not_silence_the_frames() -> None:
    timeline = Clocks().timeline()
    seconds(timeline, "pose", 100)
    seconds(timeline, "frame", 100)
    assert seconds(timeline, "pose", 3) == [Step.BACKWARD]
    assert seconds(timeline, "pose", 101) == [Step.FORWARD]
    assert seconds(timeline, "frame", 101) == [Step.FORWARD]


def test_leftovers_are_expected_for_a_while_only() -> None:
    clocks = Clocks()
    timeline = clocks.timeline()
    seconds(timeline, "pose", 100)
    seconds(timeline, "frame", 100)
    seconds(timeline, "pose", 3)
    assert seconds(timeline, "frame", 101) == [Step.PAST]
    clocks.steady = 5.1
    assert seconds(timeline, "frame", 102) == [Step.FORWARD]


def test_a_simulated_clock_that_reached_halfway_ends_the_leftovers() -> None:
    clocks = Clocks()
    clocks.now = 100 * SECOND
    timeline = clocks.timeline(simulated=True)
    seconds(timeline, "frame", 100)
    clocks.now -= SECOND // 2
    assert timeline.clock_went_back(clocks.now, SECOND // 2)
    assert seconds(timeline, "frame", 100.0) == [Step.PAST]
    clocks.now = 100 * SECOND
    assert seconds(timeline, "frame", 100.1) == [Step.FORWARD]


class Judged:
    """A timeline that goes by a clock which runs on its own."""

    def __init__(self, now: float = 1000.0, *, max_age: float | None = None) -> None:
        self.now = round(now * SECOND)
        self.steady = 0.0
        self.clock = LiveClock(lambda: self.now, lambda: self.steady)
        judge = StampJudge(self.clock, max_age)
        self.timeline = Timeline(judge=judge, steady=lambda: self.steady)

    def go(self, seconds: float, pace: float = 1.0) -> None:
        self.steady += seconds
        self.now += round(seconds * pace * SECOND)

    def see(self, kind: str, *stamps: float) -> list[Step]:
        return seconds(self.timeline, kind, *stamps)


@pytest.mark.parametrize("stamp", [0, -5])
def test_a_stamp_that_is_not_set_is_no_step_back(stamp: int) -> None:
    timeline = Clocks().timeline()
    seconds(timeline, "pose", 100)
    step, reason, details = timeline.refusal("pose", stamp)
    assert (step, reason) == (Step.UNSET, "pose_without_stamp")
    assert f"stamp {stamp} ns is not set" in details
    assert seconds(timeline, "pose", 100.1) == [Step.FORWARD]


def test_a_stamp_ahead_of_the_clock_is_refused_and_leaves_no_trace() -> None:
    judged = Judged()
    assert judged.see("pose", 1000.0, 1003.0, 1000.1) == [Step.FORWARD, Step.FUTURE, Step.FORWARD]


def test_a_single_old_stamp_is_no_step_back_where_the_clock_runs_on() -> None:
    judged = Judged()
    assert judged.see("pose", 999.9, 990.0, 1000.0) == [Step.FORWARD, Step.STALE, Step.FORWARD]


def test_stamps_that_go_back_with_the_clock_are_a_step_back() -> None:
    judged = Judged()
    judged.see("pose", 999.9)
    judged.go(-10.0)
    assert judged.see("pose", 990.0) == [Step.BACKWARD]


def test_what_is_older_than_its_input_may_be_is_stale() -> None:
    judged = Judged(max_age=2.0)
    assert judged.see("image", 997.9, 998.1) == [Step.STALE, Step.FORWARD]
    # Of poses the past is wanted too.
    assert Judged().see("pose", 990.0) == [Step.FORWARD]


def test_a_simulation_that_runs_fast_has_more_time() -> None:
    judged = Judged(max_age=2.0)
    for _ in range(20):
        judged.go(0.2, pace=10.0)
        judged.see("image", judged.now / SECOND)
    now = judged.now / SECOND
    assert judged.see("one", now - 15.0) == [Step.FORWARD]
    assert judged.see("other", now - 25.0) == [Step.STALE]


def test_stamps_of_another_clock_are_not_judged() -> None:
    judged = Judged(max_age=2.0)
    assert judged.see("image", 10.0, 11.0) == [Step.FORWARD] * 2
    assert judged.see("image", 5.0) == [Step.BACKWARD]
    # Once an input goes by the clock it is held to it.
    assert judged.see("image", 1000.0, 10.0) == [Step.FORWARD, Step.STALE]


def test_nothing_is_judged_by_a_clock_that_stands_still_or_has_not_begun() -> None:
    judged = Judged(max_age=2.0)
    judged.see("image", 1000.0)
    judged.steady += STANDSTILL
    assert judged.see("image", 1005.0) == [Step.FORWARD]
    unborn = Judged(0.0, max_age=2.0)
    assert unborn.see("image", 5.0, 30.0) == [Step.FORWARD] * 2
