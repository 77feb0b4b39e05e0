"""Memory is bounded: twice the frames, and nothing holds more."""

from __future__ import annotations

from itertools import islice
from typing import Any

import pytest
from census import census, grown

from pipeline_tracker.bench.candidates import process_stop
from pipeline_tracker.bench.recording import read_recording, to_and_fro
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.self_check import SelfCheck
from pipeline_tracker.types import State

SIZE = (320, 240)
# To and fro: after so many frames the same picture comes again.
FRAMES, SLACK = 38, 3


class Keeper:
    """What the census must notice."""

    __module__ = "pipeline_tracker.of_a_test"

    def __init__(self) -> None:
        self.kept: dict[int, list[int]] = {}
        self.tell = lambda number: self.kept.setdefault(number % 3, []).append(number)


@pytest.mark.parametrize("reach", [lambda k: k, lambda k: {"a": [k]}, lambda k: k.tell])
def test_the_census_finds_what_grows(reach: Any) -> None:
    keeper = Keeper()
    counts = []
    for number in range(60):
        keeper.tell(number)
        if number in {29, 59}:
            counts.append(census(reach(keeper)))
    assert list(grown(*counts, SLACK).values()) == [(30, 60)]


def test_twice_the_frames_take_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    # Windows that are full before the first look.
    monkeypatch.setattr("pipeline_tracker.self_check.series._KEPT", 3)
    monkeypatch.setattr(PoseBuffer.__init__, "__defaults__", (4.0,))
    recording = read_recording(None).resized(SIZE)
    assert 2 * (len(recording.pairs) - 1) == FRAMES
    assert FRAMES * recording.period_ns > 4.0 * SECOND_NS
    pipeline = Pipeline(recording.settings, recording.mounting)
    check = SelfCheck(recording.settings, recording.mounting)
    counts, tracked = [], 0
    for stop in islice(to_and_fro(recording), 2 * FRAMES):
        result = process_stop(pipeline, recording, stop)
        check.see(result.tracked)
        tracked += result.tracked.status.state is State.TRACKING
        if (stop.number + 1) % FRAMES == 0:
            counts.append(census([pipeline, check]))
    assert tracked == 2 * FRAMES
    assert sum(counts[0].values()) > 100
    assert grown(*counts, SLACK) == {}
