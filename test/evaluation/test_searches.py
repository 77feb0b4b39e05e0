"""Frames to find, and to find again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.evaluation.frames import FrameResult
from pipeline_tracker.evaluation.replay import Estimate
from pipeline_tracker.evaluation.schema import Finding
from pipeline_tracker.evaluation.searches import finding
from pipeline_tracker.evaluation.view import View
from pipeline_tracker.types import State


def frames(story: str) -> list[FrameResult]:
    """V found, f valid but false, . not valid; small o and O: the same with no pipe to find."""
    made = []
    for i, letter in enumerate(story):
        estimate = Estimate(i, "", letter in "VfO", True, "", None, None, None, {})
        false = ("end",) if letter in "fO" else ()
        view = View(in_view=True, detectable=letter not in "oO")
        made.append(FrameResult(estimate, view, false_reasons=false))
    return made


def find(story: str) -> Finding:
    found = finding(frames(story))
    assert found is not None
    assert found.basis == "detectable"
    return found


@pytest.mark.parametrize(
    ("story", "runs", "first", "again"),
    [
        ("VVVV", 1, [0], []),
        ("..VV", 1, [2], []),
        # What is not to be found does not count.
        ("oo.VV", 1, [1], []),
        ("..oo.VV", 2, [1], []),
        ("V..V.V", 1, [0], [2, 1]),
        # A false one is none.
        (".fV", 1, [2], []),
        ("VffV", 1, [0], [2]),
        # Out of sight, and there again at once, or after a while.
        ("VooV", 2, [0], [0]),
        ("VOO.V", 2, [0], [1]),
    ],
)
def test_lengths_of_searches(story: str, runs: int, first: list[int], again: list[int]) -> None:
    found = find(story)
    assert found.runs == runs
    assert found.to_find.lengths == first
    assert found.to_find_again.lengths == again
    assert found.to_find_again.never_found == 0


def test_searches_in_vain_are_counted_and_are_in_no_mean() -> None:
    found = find("...o.V..V...o")
    assert found.to_find.searches == 2
    assert (found.to_find.never_found, found.to_find.never_found_frames) == (1, 3)
    assert found.to_find.mean == 1.0
    assert found.to_find_again.lengths == [2]
    assert found.to_find_again.never_found_frames == 3
    never = find("....").to_find
    assert (never.found, never.mean, never.max, never.never_found_frames) == (0, None, None, 4)


def test_without_a_pipe_there_is_nothing_to_search() -> None:
    found = find("oooo")
    assert found.runs == found.to_find.searches == found.to_find_again.searches == 0


def test_where_it_is_not_known_what_is_hidden_being_in_view_counts() -> None:
    unknown = [replace(f, view=View(in_view=True, detectable=None)) for f in frames(".V")]
    found = finding(unknown)
    assert found is not None
    assert (found.basis, found.to_find.lengths) == ("in_view", [1])
    nothing = [replace(f, view=View(in_view=None, detectable=None)) for f in frames(".V")]
    assert finding(nothing) is None


def test_a_replay_that_lost_the_pipe(sea: Any, tmp_path: Path) -> None:
    made = sea.frames()
    for i in (0, 5, 6):
        made[i] = replace(made[i], state=State.SEARCHING, segment=None)
    made[9] = made[9].moved(np.array([0.0, 0.2, 0.0]))
    truth = sea.write_truth(tmp_path / "truth")
    found = evaluate(sea.write_replay(tmp_path / "replay", made), truth).finding
    assert found is not None
    assert (found.basis, found.runs) == ("in_view", 1)
    assert found.to_find.lengths == [1]
    assert found.to_find_again.lengths == [2, 1]
