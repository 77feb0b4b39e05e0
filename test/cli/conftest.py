"""What the tests of the command line share."""

from __future__ import annotations

from pathlib import Path

import pytest
from stand_in import StandIn


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty directory, with a stand-in for the pipeline; return the directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pipeline_tracker.replay.runner.Pipeline", StandIn)
    monkeypatch.setattr("pipeline_tracker.replay.runner.warm_up", lambda: None)
    return tmp_path
