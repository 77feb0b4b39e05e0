"""The account, the rates and the levels of a node, by a clock that the test turns."""

from __future__ import annotations

import sys
import threading

import pytest

from pipeline_tracker.diagnostics.health import ACTIVE, INACTIVE, UNCONFIGURED, Health
from pipeline_tracker.diagnostics.inputs import GRACE, InputState, InputWatch, Need
from pipeline_tracker.diagnostics.ledger import Ledger
from pipeline_tracker.diagnostics.levels import Level
from pipeline_tracker.diagnostics.margin import Margin
from pipeline_tracker.diagnostics.overall import SILENT, Overall
from pipeline_tracker.diagnostics.windows import ARRIVALS, TIMES, Percentiles, Rate


class Clock:
    """A steady clock that stands until it is turned."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_the_account_is_complete_whoever_counts() -> None:
    ledger = Ledger()
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:

        def work() -> None:
            for i in range(2000):
                ledger.received()
                if i % 2:
                    ledger.processed()
                else:
                    ledger.dropped("odd" if i % 3 else "third")

        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    account = ledger.account()
    assert (account.received, account.processed, account.lost) == (8000, 4000, 4000)
    assert account.waiting == 0
    ledger.received(3)
    assert ledger.account().waiting == 3


def test_a_rate_is_that_of_the_arrivals_and_falls_in_silence() -> None:
    rate = Rate()
    assert (rate.hertz(0.0), rate.period, rate.last) == (0.0, None, None)
    for i in range(200):
        rate.add(10.0 + 0.1 * i)
    assert len(rate._times) == ARRIVALS
    now = 10.0 + 19.9
    assert rate.hertz(now) == pytest.approx(10.0)
    assert rate.hertz(now + 0.09) == pytest.approx(10.0)
    assert rate.hertz(now + 5.0) == pytest.approx(49 / (4.9 + 4.9), rel=1e-6)
    assert rate.period == pytest.approx(0.1)


def test_percentiles_are_of_the_last_ones() -> None:
    times = Percentiles()
    assert times.of(50.0) == ()
    for i in range(3 * TIMES):
        times.add(float(i))
    low, middle, high = times.of(0.0, 50.0, 100.0)
    assert (low, high) == (2 * TIMES, 3 * TIMES - 1)
    assert middle == pytest.approx(2.5 * TIMES - 0.5)
    times.clear()
    assert times.of(50.0) == ()


def test_the_state_of_an_input() -> None:
    watch = InputWatch("image", Need.ALWAYS, now=0.0)
    assert watch.state(1.0) is InputState.NEVER
    for i in range(5):
        watch.heard(2.0 * i, age=0.1)
    assert watch.state(8.0) is InputState.OK
    assert watch.state(8.0 + 5.9) is InputState.OK, "three periods of 2 s"
    assert watch.state(8.0 + 6.1) is InputState.STALE
    watch.heard(15.0, age=1.5)
    assert watch.state(15.0) is InputState.LATE
    watch.heard(16.0, age=-1.5)
    assert watch.state(16.0) is InputState.AHEAD
    watch.heard(17.0, age=None)
    assert watch.state(17.0) is InputState.OK
    fast = InputWatch("pose", Need.WANTED, now=0.0)
    for i in range(5):
        fast.heard(0.02 * i, age=0.0)
    assert fast.state(0.5) is InputState.OK, "at least half a second"
    assert fast.state(0.6) is InputState.STALE
    told = InputWatch("image", Need.ALWAYS, timeout=3.0)
    told.heard(0.0)
    assert told.state(2.9) is InputState.OK
    assert told.state(3.1) is InputState.STALE


@pytest.mark.parametrize(
    ("need", "never", "stale"),
    [
        (Need.ALWAYS, Level.ERROR, Level.ERROR),
        (Need.WANTED, Level.WARN, Level.WARN),
        (Need.AT_TIMES, None, None),
    ],
)
def test_what_a_missing_input_is_worth(need: Need, never: Level, stale: Level) -> None:
    watch = InputWatch("vnm/pose", need, now=0.0)
    early = watch.finding(GRACE - 0.1)
    assert (early and early.level) == (Level.WARN if never is not None else None)
    late = watch.finding(GRACE + 0.1)
    assert (late and late.level) == never
    watch.heard(10.0, age=0.0)
    assert watch.finding(10.1) is None
    silent = watch.finding(20.0)
    assert (silent and silent.level) == stale
    if silent:
        assert silent.words == "vnm/pose stale for 10.0 s"


def active(clock: Clock, items: str = "frames") -> Health:
    health = Health("pipe_tracker: status", items, clock)
    health.became(ACTIVE)
    return health


def test_a_node_that_is_not_active_says_so_and_why() -> None:
    health = Health("pipe_tracker: status", steady=Clock())
    assert (health.report().level, health.report().message) == (Level.WARN, UNCONFIGURED)
    health.became(UNCONFIGURED, "pipe.diameter must be given")
    told = health.report()
    assert told.level is Level.ERROR
    assert told.message == "unconfigured: pipe.diameter must be given"
    health.became(INACTIVE)
    assert (health.report().level, health.report().message) == (Level.WARN, "inactive")
    health.became(ACTIVE)
    assert (health.report().level, health.report().message) == (Level.OK, "ok")
    assert ("state", "active") in health.report().values


def test_the_worst_finding_comes_first_and_makes_the_level() -> None:
    clock = Clock()
    health = active(clock)
    health.watch("vnm/pose", Need.WANTED)
    image = health.watch("image", Need.ALWAYS)
    health.heard(image, 0.1)
    clock.now += 20.0
    told = health.report()
    assert told.level is Level.ERROR
    assert told.message == "image stale for 20.0 s; vnm/pose never received"
    values = dict(told.values)
    assert values["image: state"] == "stale"
    assert values["vnm/pose: state"] == "never received"
    assert values["image: last one ago [s]"] == "20.00"
    assert values["image: age of its stamp [s]"] == "0.100"


def test_drops_count_for_ten_seconds_and_all_dropped_is_an_error() -> None:
    clock = Clock()
    health = active(clock, "images")
    health.report()
    health.ledger.received(10)
    health.ledger.processed(8)
    health.ledger.dropped("overrun", 2)
    told = health.report()
    assert told.level is Level.WARN
    assert told.message == "2 of 10 images dropped in the last 2 s, most: overrun"
    assert dict(told.values)["images dropped: overrun"] == "2"
    for _ in range(9):
        told = health.report()
    assert told.level is Level.OK, "ten reports later it is over"
    health.ledger.received(3)
    health.ledger.dropped("pair refused", 3)
    told = health.report()
    assert told.level is Level.ERROR
    assert "all 3 images dropped" in told.message


def test_lost_messages_mismatches_and_notes() -> None:
    clock = Clock()
    health = active(clock)
    watch = health.watch("image", Need.AT_TIMES)
    health.report()
    watch.lost += 4
    told = health.report()
    assert told.message == "4 messages sent but not received in the last 2 s"
    assert told.level is Level.WARN
    health.mismatched("image", "image: reliability does not fit")
    health.note("tracking", "searching", Level.WARN, "searching: pipe_not_found")
    told = health.report()
    assert "reliability does not fit" in told.message
    assert "searching: pipe_not_found" in told.message
    assert dict(told.values)["tracking"] == "searching"
    health.note("tracking", "tracking")
    assert "searching" not in health.report().message
    assert health.unused("vnm/pose refused") == 1
    assert health.unused("vnm/pose refused", 2) == 3
    assert dict(health.report().values)["not used: vnm/pose refused"] == "3"


def test_latency_is_told_in_percentiles() -> None:
    health = active(Clock())
    assert not any(key.startswith("latency") for key, _ in health.report().values)
    for i in range(1, 101):
        health.latency.add(i / 1000.0)
    values = dict(health.report().values)
    assert values["latency, median [ms]"] == "50"
    assert values["latency, 95 % [ms]"] == "95"
    assert values["latency, most [ms]"] == "100"


def test_memory_is_bounded() -> None:
    clock = Clock()
    health = active(clock)
    watch = health.watch("image", Need.ALWAYS)
    for _ in range(2000):
        clock.now += 0.05
        health.heard(watch, 0.1)
        health.latency.add(0.1)
        health.report()
    held = len(watch._rate._times), len(health.latency._times), len(health._past)
    assert held == (ARRIVALS, TIMES, 10)


def test_the_overall_level_is_the_worst_and_a_silent_node_is_an_error() -> None:
    clock = Clock()
    overall = Overall("pipeline_tracker: overall", ["a", "b"], clock)
    assert overall.report().level is Level.WARN, "right after the start"
    overall.hear("a", 0, "ok")
    overall.hear("b", 0, "ok")
    overall.hear("of others", 2, "motor on fire")
    assert (overall.report().level, overall.report().message) == (Level.OK, "ok")
    assert dict(overall.report().values)["last valid relative state ago [s]"] == "never"
    overall.hear("b", 1, "inactive")
    assert (overall.report().level, overall.report().message) == (Level.WARN, "b: inactive")
    overall.hear("a", 2, "image stale")
    assert overall.report().message == "a: image stale; b: inactive"
    overall.published(valid=True)
    overall.published(valid=False)
    clock.now += SILENT + 0.1
    overall.hear("b", 0, "ok")
    told = overall.report()
    assert (told.level, told.message) == (Level.ERROR, "a is silent")
    assert dict(told.values)["a"] == "SILENT"
    assert dict(told.values)["last valid relative state ago [s]"] == "3.1"


def test_the_margin_of_5_3_1() -> None:
    health = active(Clock())
    margin = Margin(0.3)
    margin.tell(health.note)
    assert health.report().level is Level.OK
    for _ in range(5):
        margin.see(0.8, 0.5, 0.05)
    margin.tell(health.note)
    values = dict(health.report().values)
    assert health.report().level is Level.OK
    assert values["5.3.1: time used t1, 95 % [ms]"] == "50"
    assert values["5.3.1: time available t2 [ms]"] == "500"
    assert values["5.3.1: overlap"] == "0.80"
    for _ in range(5):
        margin.see(0.2, 0.04, 0.05)
    margin.tell(health.note)
    told = health.report()
    assert told.level is Level.WARN
    assert "images overlap by 0.20, least 0.3 (5.3.1)" in told.message
    assert "a frame takes 50 ms of 40 ms (5.3.1)" in told.message
    margin.see(None, None, 0.05)
