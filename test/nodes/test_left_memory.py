"""Shared memory that killed processes leave is taken back, and nothing else."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline_tracker.nodes import left_memory
from pipeline_tracker.nodes.left_memory import left_segments, remove_left_segments

fcntl = pytest.importorskip("fcntl")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux alone")

# Joins in as our nodes do, says so, and waits to be killed.
_NODE = """
import sys
from pipeline_tracker.nodes.process import prepare_transport
prepare_transport(local=True)
import rclpy
rclpy.init()
node = rclpy.create_node("short_lived")
print("ready", flush=True)
sys.stdin.read()
"""


def segment(place: Path, number: int, *, old: bool = True) -> Path:
    path = place / f"fastrtps_{number:016x}"
    for file in (path, path.with_name(f"{path.name}_el")):
        file.write_bytes(b"x")
        if old:
            os.utime(file, (1.0, 1.0))
    return path


def test_what_nobody_holds_is_removed(tmp_path: Path) -> None:
    left, held, young = segment(tmp_path, 1), segment(tmp_path, 2), segment(tmp_path, 3, old=False)
    others = tmp_path / "fastrtps_port7411", tmp_path / "fastrtps_port7411_el", tmp_path / "mine_el"
    for other in others:
        other.touch()
        os.utime(other, (1.0, 1.0))
    with held.with_name(f"{held.name}_el").open("r+b") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert left_segments(tmp_path) == [left]
        assert remove_left_segments(tmp_path) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        [held.name, f"{held.name}_el", young.name, f"{young.name}_el", *(p.name for p in others)]
    )
    # Its process has ended.
    assert remove_left_segments(tmp_path) == 1
    assert remove_left_segments(tmp_path) == 0


def test_a_directory_that_is_not_there_has_none(tmp_path: Path) -> None:
    assert remove_left_segments(tmp_path / "none") == 0


@pytest.mark.ros
def test_the_segment_of_a_process_is_left_once_it_is_killed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(left_memory, "_SETTLED", 0.0)
    process = subprocess.Popen(
        [sys.executable, "-c", _NODE], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        assert process.stdout.readline() == b"ready\n"
        maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="ascii")
        mapped = set(re.findall(r"/dev/shm/(fastrtps_[0-9a-f]{16})$", maps, re.MULTILINE))  # noqa: S108
        own = mapped - {path.name for path in left_segments()}
        assert own
        process.kill()
        process.wait()
    assert own & {path.name for path in left_segments()}
    for path in left_segments():
        if path.name in own:
            path.unlink()
            path.with_name(f"{path.name}_el").unlink()
