"""Shares of the long runs over mutated settings files and messages (``test/soak``)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).resolve().parent / "soak"


def run(script: str, count: int) -> str:
    done = subprocess.run(
        [sys.executable, str(SOAK / script), "--count", str(count), "--seed", "100000"],
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_mutated_settings_files_give_settings_or_our_error() -> None:
    out = run("fuzz_settings.py", 100)
    assert "100 files" in out
    for outcome in ("bomb: refused", "value: refused", "line: done"):
        assert outcome in out


@pytest.mark.ros
def test_mutated_messages_give_our_error_and_end_no_node() -> None:
    pytest.importorskip("rclpy")
    out = run("fuzz_messages.py", 150)
    assert "150 messages" in out
    for outcome in ("vectorized of rosbags: refused", "vnm/pose of the nodes: refused or dropped"):
        assert outcome in out
