"""The user's own numbers, right and wrong, on the demo's frames."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dive import Dive, other_baseline, scaled_poses, vectorized

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import VectorizedStereo

DEMO = Path(__file__).resolve().parents[2] / "bags" / "demo"


@pytest.fixture(scope="module")
def dive() -> Dive:
    return vectorized(DEMO, diameter=0.6, count=12)


def number_after(text: str, words: str) -> float:
    found = re.search(re.escape(words) + r"(-?[0-9.]*[0-9])", text)
    assert found, text
    return float(found[1])


def test_right_numbers_are_not_warned_of(dive: Dive) -> None:
    assert dive.warnings() == []


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_wrong_diameter(dive: Dive, share: float) -> None:
    (told,) = dive.warnings(diameter=round(share * 0.6, 4))
    assert told.startswith("pipe.diameter is wrong")
    assert number_after(told, "they suggest pipe.diameter=") == pytest.approx(0.6, rel=0.02)
    assert number_after(told, "a pipe ") == pytest.approx(1.0 / share, rel=0.02)


def test_wrong_diameter_without_poses(dive: Dive) -> None:
    (told,) = dive.warnings(lambda frame, _: (frame, None), diameter=0.54)
    assert told.startswith("pipe.diameter or the baseline is wrong")
    assert number_after(told, "a baseline of ") == pytest.approx(0.18, rel=0.02)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_wrong_baseline(dive: Dive, share: float) -> None:
    (told,) = dive.warnings(other_baseline(share))
    assert told.startswith("the baseline is probably wrong")
    assert number_after(told, "a baseline of ") == pytest.approx(0.2, rel=0.02)


@pytest.mark.parametrize("scale", [0.93, 1.07])
def test_poses_of_a_wrong_scale(dive: Dive, scale: float) -> None:
    (told,) = dive.warnings(scaled_poses(scale))
    assert told.startswith("the scale of vnm/pose")
    assert number_after(told, "the pictures show ") == pytest.approx(1.0 / scale, rel=0.02)


@pytest.mark.parametrize("turn", [(0.0, -0.052, 0.0), (0.0, 0.0, 1.57)])
def test_turned_mounting(dive: Dive, turn: tuple[float, float, float]) -> None:
    (told,) = dive.warnings(turn=turn)
    assert told.startswith("the mounting or vnm/pose is turned")
    degrees = np.degrees(np.linalg.norm(turn))
    assert number_after(told, "show a way ") == pytest.approx(degrees, abs=1.0 + 0.06 * degrees)
    numbers = re.search(r"rotation_rpy=\[(.*)\]", told)
    assert numbers
    # What it suggests is the mounting that is right.
    suggested = Pose.from_rpy([0.0, 0.0, 0.0], [float(n) for n in numbers[1].split(",")])
    off = suggested.rotation @ dive.mounting.rotation.T
    # A turn about the way itself does not show: compare where the way leads.
    assert off[0, 0] > np.cos(np.radians(1.5 + 0.06 * degrees))


@pytest.mark.parametrize("rows", [-2.0, 1.0])
def test_rows_apart(dive: Dive, rows: float) -> None:
    def lower(frame: VectorizedStereo, pose: Pose) -> tuple[VectorizedStereo, Pose]:
        shift = np.array([0.0, 0.0, 0.0, rows], np.float32)
        return replace(frame, matches=frame.matches + shift), pose

    (told,) = dive.warnings(lower)
    assert told.startswith("the pair is not rectified to the same rows")
    assert number_after(told, "shows is ") == pytest.approx(abs(rows), abs=0.15)
    assert ("lower" if rows > 0 else "higher") in told


def test_few_frames_are_not_enough(dive: Dive) -> None:
    few = Dive(dive.settings, dive.mounting, dive.frames[:5])
    assert few.warnings(scaled_poses(1.3), diameter=0.5) == []
