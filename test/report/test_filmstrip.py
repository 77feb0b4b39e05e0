"""The pictures of a replay: which frames they are of, and how much room they take."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.report import filmstrip
from pipeline_tracker.report.filmstrip import FilmStrip, pictures
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import RelativeState, State, TrackingStatus, VectorizedStereo

LEFT = Camera(80.0, 80.0, 31.5, 23.5, 64, 48)
GREY = np.full((48, 64), 90, np.uint8)


def result(stamp: int, quality: float, camera: Camera = LEFT) -> FrameResult:
    """Return a frame; one of no quality is not valid."""
    nothing = np.zeros((0, 4), np.float32)
    vectorized = VectorizedStereo(stamp, StereoRig(camera), nothing, nothing, nothing, GREY, GREY)
    status = TrackingStatus(stamp, State.TRACKING, "", quality, 0.0, 0)
    return FrameResult(
        vectorized, None, TrackedFrame(status, None), RelativeState(stamp, quality > 0, quality, 0)
    )


@pytest.fixture
def strip(tmp_path: Path) -> Callable[..., list[int]]:
    """Take in frames of such qualities; return the stamps that have a picture."""

    def take(qualities: Iterable[float], expected: int, begin: int = 0) -> list[int]:
        made = FilmStrip(tmp_path / "frames", Pose.identity(), expected, begin=begin)
        for stamp, quality in enumerate(qualities, start=begin):
            made.take(GREY, result(stamp, quality))
        made.finish()
        return list(pictures(tmp_path))

    return take


def test_each_of_few_frames_has_one(strip: Callable[..., list[int]]) -> None:
    assert strip([0.9] * 100, 100) == list(range(100))


def test_of_many_the_first_the_worst_and_the_losses_of_each_part(
    strip: Callable[..., list[int]],
) -> None:
    qualities = [0.9] * 1200
    qualities[25], qualities[26] = 0.5, 0.4
    qualities[31:48] = [0.0] * 17
    chosen = strip(qualities, 1200)
    # Parts of ten frames.
    assert {k for k in chosen if k % 10 == 0} == set(range(0, 1200, 10))
    assert 26 in chosen
    assert 25 not in chosen
    assert 31 in chosen
    assert 32 not in chosen
    assert len(chosen) <= 360


def test_frames_that_come_and_go_have_a_bounded_number(strip: Callable[..., list[int]]) -> None:
    chosen = strip([0.8, 0.0] * 2000, 3600)
    assert len(chosen) <= 360


def test_a_replay_that_goes_on_has_the_same_pictures(
    strip: Callable[..., list[int]], tmp_path: Path
) -> None:
    qualities = [0.5 + 0.4 * ((7 * k) % 13) / 13 for k in range(600)]
    strip(qualities[:300], 600)
    resumed = strip(qualities[300:], 600, begin=300)
    for path in pictures(tmp_path).values():
        path.unlink()
    assert resumed == strip(qualities, 600)


def test_a_picture_is_never_larger_than_its_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(3).integers(0, 255, (800, 1200), np.uint8)
    camera = replace(LEFT, width=1200, height=800)
    FilmStrip(tmp_path / "few", Pose.identity(), 20).take(noise, result(1, 0.9, camera))
    wide = cv2.imread(str(tmp_path / "few" / "1.jpg"))
    assert (tmp_path / "few" / "1.jpg").stat().st_size <= 160_000
    assert wide.shape[1] >= 480
    FilmStrip(tmp_path / "many", Pose.identity(), 10_000).take(noise, result(1, 0.9, camera))
    assert (tmp_path / "many" / "1.jpg").stat().st_size <= 50_000
    monkeypatch.setattr(filmstrip, "_MOST_FOR_ONE", 2000)
    FilmStrip(tmp_path / "tiny", Pose.identity(), 20).take(noise, result(1, 0.9, camera))
    assert (tmp_path / "tiny" / "1.jpg").stat().st_size <= 2000


def test_only_pictures_of_frames_are_listed(tmp_path: Path) -> None:
    assert pictures(tmp_path) == {}
    (tmp_path / "frames").mkdir()
    for name in ("20.jpg", "3.jpg", "holiday.jpg", "4.png"):
        (tmp_path / "frames" / name).write_bytes(b"")
    assert list(pictures(tmp_path)) == [3, 20]
