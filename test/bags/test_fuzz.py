"""A share of the long run over damaged bags: ``python test/soak/fuzz_bags.py --count 5000``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[1] / "soak" / "fuzz_bags.py"


def test_damaged_bags_give_our_error_alone() -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--count", "40", "--seed", "100000"],
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "40 bags" in done.stdout
    for outcome in ("replay, cut: refused", "info, flips: done", "salvage, cut: done"):
        assert outcome in done.stdout
