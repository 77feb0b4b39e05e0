"""A truth that does not belong to a replay is a failure, not a number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.geometry.pose import Pose

TRUTH_ALONE = ("/stereo", "/vnm", "/tf_static")


def noise(seed: int, level: float = 60.0) -> list[Any]:
    rng = np.random.default_rng(seed)
    return list(rng.normal(level, level / 4.0, (12, 128, 160)).clip(0, 255).astype(np.uint8))


@pytest.fixture
def other(make_sea: Callable[..., Any]) -> Any:
    """Another sea with the same stamps: another path and other images."""
    sea = make_sea()
    away = Pose.from_rpy([0.0, 0.05, 0.02], [0.01, 0.0, 0.02])
    sea.poses = [pose @ away for pose in sea.poses]
    sea.images = noise(2)
    return sea


@pytest.fixture
def replayed(sea: Any, tmp_path: Path) -> Path:
    sea.images = noise(1)
    return Path(sea.write_replay(tmp_path / "replay", sea.frames()))


def test_the_bag_itself_fits(sea: Any, replayed: Path, tmp_path: Path) -> None:
    fit = evaluate(replayed, sea.write_truth(tmp_path / "own")).fit
    assert (fit.images_compared, fit.poses_compared) == (5, 12)
    assert fit.mounting_offset == pytest.approx(0.0, abs=1e-12)
    assert fit.mounting_angle == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("missing", "images", "poses"),
    [(("/stereo",), 0, 12), (("/vnm",), 5, 0), (TRUTH_ALONE, 0, 0)],
)
def test_parts_of_the_bag_itself_fit(
    sea: Any, replayed: Path, tmp_path: Path, missing: tuple[str, ...], images: int, poses: int
) -> None:
    result = evaluate(replayed, sea.write_truth(tmp_path / "own", leave_out=missing))
    assert (result.fit.images_compared, result.fit.poses_compared) == (images, poses)
    assert result.groups["all"].divergence.total.max == pytest.approx(0.0, abs=1e-8)


def test_another_sea_is_refused_by_its_images(other: Any, replayed: Path, tmp_path: Path) -> None:
    truth = other.write_truth(tmp_path / "other", leave_out=("/vnm",))
    with pytest.raises(EvaluationError, match=r"left image of stamp \d+ ns is another one"):
        evaluate(replayed, truth)


def test_another_dark_sea_is_refused_by_its_images(sea: Any, other: Any, tmp_path: Path) -> None:
    # Thumbnails of noise alone, one grey level apart.
    sea.images, other.images = noise(1, 6.0), noise(2, 6.0)
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    other.images = [image + 1 for image in other.images]
    with pytest.raises(EvaluationError, match="is another one"):
        evaluate(directory, other.write_truth(tmp_path / "other"))


def test_another_sea_without_images_is_refused_by_its_poses(
    other: Any, replayed: Path, tmp_path: Path
) -> None:
    truth = other.write_truth(tmp_path / "other", leave_out=("/stereo",))
    with pytest.raises(EvaluationError, match="12 of 12 poses of /vnm/pose are other ones"):
        evaluate(replayed, truth)


def test_another_truth_alone_is_refused_by_its_motion(
    other: Any, replayed: Path, tmp_path: Path
) -> None:
    other.poses = [
        pose @ Pose.from_rpy([0.0, 0.06 * (i % 2), 0.0], [0.0, 0.0, 0.0])
        for i, pose in enumerate(other.poses)
    ]
    truth = other.write_truth(tmp_path / "other", leave_out=TRUTH_ALONE)
    with pytest.raises(EvaluationError, match="true motion is not the one"):
        evaluate(replayed, truth)


def test_drift_is_no_other_motion(sea: Any, tmp_path: Path) -> None:
    drift = Pose.from_rpy([0.01, 0.008, -0.004], [0.002, 0.003, 0.01])
    poses = [sea.poses[0]]
    for before, after in pairwise(sea.poses):
        poses.append(poses[-1] @ before.inverse() @ after @ drift)
    sea.vnm = poses
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    truth = sea.write_truth(tmp_path / "truth", leave_out=TRUTH_ALONE)
    assert evaluate(directory, truth).fit.steps_compared == 11


def test_a_bag_with_images_of_other_stamps_is_refused(
    sea: Any, replayed: Path, make_sea: Callable[..., Any], tmp_path: Path
) -> None:
    # Its poses come often and reach over the replay's stamps; its images lie between these.
    often = make_sea(count=130)
    often.stamps = [sea.stamps[0] - 25_000_000 + i * 50_000_000 for i in range(130)]
    often.images = noise(1) * 11
    with pytest.raises(EvaluationError, match="it has no left image of stamp"):
        evaluate(replayed, often.write_truth(tmp_path / "truth"))


@pytest.mark.parametrize(
    ("side", "change", "text"),
    [
        (0, {"fx": 201.0}, "left camera is another one .fx is 201, 200 was replayed"),
        (1, {"offset": 0.21}, "right camera is another one .offset is 0.21, 0.2 was replayed"),
        (0, {"cy": 60.0}, "left camera is another one .cy is 60"),
    ],
)
def test_other_cameras_are_refused(
    sea: Any, replayed: Path, tmp_path: Path, side: int, change: dict[str, float], text: str
) -> None:
    cameras = list(sea.cameras)
    cameras[side] = replace(cameras[side], **change)
    if "cy" in change:
        cameras[1] = replace(cameras[1], **change)
    sea.cameras = tuple(cameras)
    with pytest.raises(EvaluationError, match=text):
        evaluate(replayed, sea.write_truth(tmp_path / "other"))


def test_another_mounting_is_told_where_the_bag_is_the_same(
    sea: Any, replayed: Path, tmp_path: Path
) -> None:
    # Replayed with a wrong mounting on purpose: its errors are to be seen.
    sea.mounting = sea.mounting @ Pose.from_rpy([0.03, 0.0, 0.0], [0.0, 0.0, 0.01])
    fit = evaluate(replayed, sea.write_truth(tmp_path / "own")).fit
    assert fit.mounting_offset == pytest.approx(0.03)
    assert fit.mounting_angle == pytest.approx(0.01)


def test_another_mounting_is_refused_where_nothing_else_is_known(
    sea: Any, replayed: Path, tmp_path: Path
) -> None:
    sea.mounting = sea.mounting @ Pose.from_rpy([0.03, 0.0, 0.0], [0.0, 0.0, 0.01])
    truth = sea.write_truth(tmp_path / "own", leave_out=("/stereo/left/image", "/vnm"))
    with pytest.raises(EvaluationError, match=r"mounted 3.0 cm and 0.6 degrees off"):
        evaluate(replayed, truth)
