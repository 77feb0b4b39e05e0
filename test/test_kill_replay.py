"""A share of the long run of kills: ``python test/soak/kill_replay.py --kills 20``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).resolve().parent / "soak" / "kill_replay.py"


def test_a_killed_replay_is_resumed_to_the_same_bytes() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--kills", "1", "--seed", "3"],
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 kills, 1 replays resumed: all 20 rows" in done.stdout
