"""How fast it must be (5.3.1): planned and watched."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from swim import Swim, settings_of
from synthetic_world import LEFT, RIG, Diver, World, level_pose

from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import SettingsError
from pipeline_tracker.limits import OverlapWatch, Plan

POINT, ALONG = np.array([0.0, 0.0, 2.0]), np.array([0.0, -1.0, 0.0])
# What a camera looking straight down has in view of a level pipe at 2 m.
LENGTH = 2.0 * LEFT.height / LEFT.fy


def test_the_example_of_the_method() -> None:
    plan = Plan(altitude=2.0, angle=60.0, overlap=0.7, speed=1.0)
    assert plan.seen_length == pytest.approx(4.0 * math.tan(math.radians(30.0)))
    assert plan.time == pytest.approx(0.693, abs=5e-4)


def test_a_tilted_camera_sees_more() -> None:
    # Rays at 0 and 60 degrees from straight down, by hand.
    assert Plan(tilt=30.0).seen_length == pytest.approx(2.0 * math.sqrt(3.0))
    assert Plan(tilt=-30.0).seen_length == pytest.approx(2.0 * math.sqrt(3.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"altitude": 0.0},
        {"altitude": math.nan},
        {"angle": 180.0},
        {"overlap": 1.0},
        {"overlap": -0.1},
        {"speed": 0.0},
        {"speed": math.inf},
        {"tilt": 60.0},
        {"tilt": math.nan},
    ],
)
def test_what_no_dive_can_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=f"--{next(iter(wrong))}"):
        Plan(**wrong).check()


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["limits"]) == 0
    assert "t2 = 693 ms" in capsys.readouterr().out
    assert run_command(["limits", "--speed", "0.5", "--time", "1300"]) == 0
    assert "t1 <= t2 holds" in capsys.readouterr().out
    assert run_command(["limits", "--time", "700"]) == 1
    assert "does not hold" in capsys.readouterr().out
    for wrong in (["--time", "0"], ["--time", "nan"], ["--tilt", "80"], ["--overlap", "much"]):
        assert run_command(["limits", *wrong]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1


def test_overlap_is_what_the_step_leaves() -> None:
    watch = OverlapWatch(0.3)
    overlap, warning, allowed = watch.see(POINT, ALONG, 0.25 * LENGTH, 1.0, LEFT)
    assert allowed == pytest.approx(0.7 / 0.25)
    assert overlap == pytest.approx(0.75, abs=1e-6)
    assert watch.see(POINT, ALONG, -0.25 * LENGTH, 1.0, LEFT)[0] == pytest.approx(0.75, abs=1e-6)
    assert warning == ""


def test_too_little_overlap_is_told_once_and_only_when_it_stays() -> None:
    watch, far, near = OverlapWatch(0.3), 0.8 * LENGTH, 0.1 * LENGTH
    told = [watch.see(POINT, ALONG, way, 2.0, LEFT)[1] for way in (far, far, near, far, far)]
    assert told == [""] * 5
    warning = watch.see(POINT, ALONG, far, 2.0, LEFT)[1]
    assert "overlap 0.20" in warning
    # 0.7 of the length at 0.4 of it a second.
    assert "1750 ms" in warning
    assert "every 2000 ms" in warning
    assert watch.see(POINT, ALONG, far, 2.0, LEFT)[1] == ""


def test_the_tracker_watches() -> None:
    settings = settings_of(motion={"min_overlap": 0.9})
    swim = Swim(Diver(World.with_pipe(heading=0.1), RIG), settings)
    frames = [swim.step(1.0 * k, level_pose(x=0.3 * k)) for k in range(6)]
    assert frames[0].overlap is None
    way = 0.3 * math.cos(0.1)
    for frame in frames[1:]:
        assert frame.overlap == pytest.approx(1.0 - way / LENGTH, abs=0.02)
    assert [len(frame.warnings) for frame in frames] == [0, 0, 0, 1, 0, 0]
    assert "motion.min_overlap=0.9" in frames[3].warnings[0]


def test_a_plan_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "limits.png"
    assert run_command(["limits", "--time", "75", "--plot", str(file)]) == 0
    assert f"drawn in {file}" in capsys.readouterr().out
    picture = cv2.imread(str(file))
    assert picture is not None
    # Its lines: five colours of their own, the planned one orange.
    orange = np.array([0, 159, 230])
    assert (np.abs(picture.astype(int) - orange).max(axis=2) < 30).sum() > 500


@pytest.mark.parametrize("name", ["limits.xyz", "none/limits.png"])
def test_a_plot_that_cannot_be_written(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["limits", "--plot", str(tmp_path / name)]) == 2
    assert "--plot" in capsys.readouterr().err
