"""Waiting on a clock that may be simulated, stop or go back."""

from __future__ import annotations

import pytest

from pipeline_tracker.nodes.live_clock import STANDSTILL, LiveClock

SECOND = 1_000_000_000


class Clocks:
    def __init__(self) -> None:
        self.now = 100 * SECOND
        self.steady = 7.0
        self.live = LiveClock(lambda: self.now, lambda: self.steady)

    def go(self, simulated: float, real: float) -> None:
        """Let both clocks run in small steps, looked at as a timer does."""
        for _ in range(20):
            self.now += round(simulated * SECOND / 20)
            self.steady += real / 20
            self.live.now_ns()


def test_time_is_that_of_the_clock_however_fast_it_runs() -> None:
    clocks = Clocks()
    mark = clocks.live.mark()
    clocks.go(simulated=6.0, real=2.0)
    assert clocks.live.since(mark) == pytest.approx(6.0)
    clocks.go(simulated=0.1, real=4.0)
    assert clocks.live.since(mark) == pytest.approx(6.1)


def test_while_the_clock_stands_still_real_time_counts() -> None:
    clocks = Clocks()
    mark = clocks.live.mark()
    clocks.go(simulated=1.0, real=1.0)
    clocks.go(simulated=0.0, real=0.9 * STANDSTILL)
    assert clocks.live.since(mark) == pytest.approx(1.0)
    clocks.go(simulated=0.0, real=2.0)
    assert clocks.live.since(mark) == pytest.approx(3.0 + 0.9 * STANDSTILL)


def test_a_clock_that_never_started_does_not_hold_up_a_wait() -> None:
    clocks = Clocks()
    clocks.go(simulated=0.0, real=60.0)
    # What passed before the mark does not count.
    mark = clocks.live.mark()
    assert clocks.live.since(mark) == 0.0
    clocks.go(simulated=0.0, real=0.7)
    assert clocks.live.since(mark) == pytest.approx(0.7)


def test_a_clock_that_went_back_gives_less_than_nothing() -> None:
    clocks = Clocks()
    mark = clocks.live.mark()
    clocks.now -= 40 * SECOND
    assert clocks.live.since(mark) == pytest.approx(-40.0)


def test_the_pace_is_that_of_the_last_while_and_at_least_1() -> None:
    clocks = Clocks()
    assert clocks.live.pace == 1.0
    clocks.go(simulated=30.0, real=3.0)
    assert clocks.live.pace == pytest.approx(10.0, rel=0.01)
    clocks.go(simulated=1.0, real=2.0)
    assert clocks.live.pace == 1.0
    clocks.now -= 40 * SECOND
    clocks.live.now_ns()
    assert clocks.live.pace == 1.0


def test_a_clock_runs_from_its_beginning_until_it_stands_still() -> None:
    clocks = Clocks()
    clocks.now = 0
    unborn = LiveClock(lambda: clocks.now, lambda: clocks.steady)
    assert not unborn.runs
    clocks.now = SECOND
    unborn.now_ns()
    assert unborn.runs
    clocks.steady += STANDSTILL
    assert not unborn.runs
