"""Hashes of code: what is named there is in the package."""

from __future__ import annotations

from pathlib import Path

import pytest

import pipeline_tracker
from pipeline_tracker.benchmark.fingerprint import _NOT_MEASURING, SIMULATOR
from pipeline_tracker.replay.record import _NO_PART

PACKAGE = Path(pipeline_tracker.__file__).parent


@pytest.mark.parametrize("names", [_NOT_MEASURING, SIMULATOR, _NO_PART])
def test_every_name_is_that_of_a_module(names: tuple[str, ...]) -> None:
    assert [name for name in names if not (PACKAGE / name).exists()] == []
