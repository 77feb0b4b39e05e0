"""Memory of the live nodes is bounded: twice the frames, and no node holds more."""

from __future__ import annotations

from typing import Any

import pytest
from census import census, grown

from pipeline_tracker.markers import Centerline

pytestmark = pytest.mark.ros

# What is told once a second may still come to be.
FRAMES, SLACK, PERIOD = 48, 12, 1_000_000_000


def test_twice_the_frames_take_no_more_memory(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    # Windows that are full before the first look.
    for window in ("diagnostics.windows.TIMES", "diagnostics.windows.ARRIVALS"):
        monkeypatch.setattr(f"pipeline_tracker.{window}", 20)
    monkeypatch.setattr("pipeline_tracker.self_check.series._KEPT", 3)
    monkeypatch.setattr(Centerline.__init__, "__defaults__", (0.25, 5))
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    counts, valid = [], 0
    way = [0, 1, 2, 3, 2, 1]
    for number in range(2 * FRAMES):
        k = way[number % len(way)]
        shift = bench.scene.start_ns + number * PERIOD - bench.scene.stamp(k)
        valid += vehicle.drive(k, shift_ns=shift).valid
        if (number + 1) % FRAMES == 0:
            counts.append({node.NAME: census(node) for node in live.nodes})
    assert valid > FRAMES
    for name, before in counts[0].items():
        assert sum(before.values()) > 20
        assert grown(before, counts[1][name], SLACK) == {}, name
