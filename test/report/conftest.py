"""Replays for reports, with the stand-in for the pipeline."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bag_maker import Sea, write_bag
from stand_in import StandIn

from pipeline_tracker.replay import replay
from pipeline_tracker.settings_io import settings_from_values

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Replay a sea, or the bag at a path, and return the output's directory."""
    numbers = itertools.count()

    def run(
        sea: Sea | Path | None = None,
        *,
        name: str = "sea",
        before: Callable[[int], None] | None = None,
        **options: Any,
    ) -> Path:
        number = next(numbers)
        bag = sea if isinstance(sea, Path) else tmp_path / str(number) / name
        if not isinstance(sea, Path):
            bag.parent.mkdir()
            write_bag(bag, (sea or Sea()).items())
        values = {"pipe.diameter": 0.6, **{k.replace("__", "."): v for k, v in options.items()}}

        def pipeline(*arguments: Any) -> StandIn:
            made = StandIn(*arguments)
            made.before = before or made.before
            return made

        output = tmp_path / f"output{number}"
        replay(
            bag, settings_from_values(values), output, stream=io.StringIO(), make_pipeline=pipeline
        )
        return output

    return run
