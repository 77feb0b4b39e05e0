"""`bench --live`: the nodes under load, for a moment."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline_tracker.bench.live import Load, check_live, measure_live
from pipeline_tracker.bench.recording import read_recording
from pipeline_tracker.cli import run_command

DEMO = Path(__file__).resolve().parents[2] / "bags" / "demo"


@pytest.mark.ros
@pytest.mark.parametrize("processes", [1, 4])
def test_every_pair_is_answered_or_counted_as_dropped(processes: int) -> None:
    pytest.importorskip("psutil")
    recording = read_recording(DEMO, ("pipe.diameter=0.6",)).resized((480, 320))
    check_live(recording)
    told: list[str] = []
    live = measure_live(recording, told.append, (Load(2.0, processes),), 3.0, cold=False)
    (row,) = live.rows
    assert (live.width, live.height) == (480, 320)
    assert row.processes == processes
    assert row.published == 6
    assert row.answered + row.dropped == 6
    # Slow enough for a busy machine: most pairs come back, and the pipe is in them.
    assert row.valid >= 3
    assert row.p50_ms is not None
    assert row.max_ms is not None
    assert 0.0 < row.p50_ms <= row.max_ms < 3000.0
    assert row.cpu_percent > 0.0
    # All processes count: a node alone has more than 100 MB of libraries.
    assert row.memory_mb > 100.0 * processes
    assert row.ready_s > 0.0
    assert len(told) == 1


def test_without_ros_it_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(DEMO.parents[1])
    monkeypatch.setitem(__import__("sys").modules, "rclpy", None)
    assert run_command(["bench", "--live", "--sizes", "480x320"]) == 2
    error = capsys.readouterr().err
    assert "bench --live needs ROS 2" in error
    assert error.count("\n") == 1
