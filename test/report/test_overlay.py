"""Overlay pictures: what was found is drawn where it was found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.report.overlay import (
    _AXIS,
    _LEFT_CONTOUR,
    _RIGHT_CONTOUR,
    _SEGMENTS,
    OverlayKeeper,
    draw_overlay,
)
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import (
    Contours,
    Mode,
    PipeSegment,
    RelativeState,
    State,
    TrackingStatus,
    VectorizedStereo,
)

LEFT = Camera(500.0, 500.0, 319.5, 239.5, 640, 480)
RIG = StereoRig(LEFT, replace(LEFT, offset=0.2))
MOUNTING = Pose.from_rpy([0.3, 0.1, -0.1], [-2.618, 0.0, -1.571])
GREY = np.full((480, 640), 60, np.uint8)


def result(*, quality: float = 0.5, valid: bool = True, found: bool = True) -> FrameResult:
    # A pipe 2 m before the camera, its axis 0.1 m to the right.
    ends = MOUNTING.apply(np.array([[0.1, 0.2, 2.0], [0.1, -0.2, 2.0]]))
    segment = PipeSegment(
        stamp_ns=1,
        mode=Mode.TRACKING,
        technique=0,
        start=ends[0],
        end=ends[1],
        radius=0.3,
        covariance=1e-8 * np.eye(4),
        support=0.5,
        visible_contours=Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_RIGHT,
        contours=np.array([[270, 0, 270, 479], [370, 0, 370, 479]], np.float32),
    )
    state = State.TRACKING if found else State.SEARCHING
    nothing = np.zeros((0, 4), np.float32)
    vectorized = VectorizedStereo(
        1, RIG, np.array([[500, 400, 600, 400]], np.float32), nothing, nothing, GREY, GREY
    )
    tracked = TrackedFrame(TrackingStatus(1, state, "", 0.5, 0.0, 0), segment if found else None)
    return FrameResult(vectorized, None, tracked, RelativeState(1, valid, quality, 0))


def colour_at(picture: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    return tuple(int(v) for v in picture[round(y), round(x)])


def test_each_thing_has_its_place_and_colour() -> None:
    picture = draw_overlay(GREY, GREY, result(), MOUNTING)
    assert picture.shape == (480, 1280, 3)
    assert colour_at(picture, 270, 300) == _LEFT_CONTOUR
    assert colour_at(picture, 640 + 370, 300) == _RIGHT_CONTOUR
    assert colour_at(picture, 640 + 270, 300) != _LEFT_CONTOUR, "the contour of the other image"
    assert colour_at(picture, 550, 400) == pytest.approx(_SEGMENTS, abs=20)
    # 500 * 0.1 / 2 right of the centre, and 500 * 0.2 / 2 less of it in the right image.
    assert colour_at(picture, 319.5 + 25, 239.5) == _AXIS
    assert colour_at(picture, 640 + 319.5 - 25, 239.5) == _AXIS
    assert (picture[:40, :200] > 150).any(), "there are words"


def test_a_lost_pipe_is_shown_where_it_is_expected() -> None:
    seen = result()
    segment = seen.tracked.segment
    assert segment is not None
    coasted = replace(
        segment,
        support=0.0,
        visible_contours=Contours.NONE,
        contours=np.zeros((0, 4), np.float32),
        covariance=np.diag([1e-3, 1e-3, 1e-6, 1e-6]),
    )
    status = replace(seen.tracked.status, state=State.COASTING)
    found = replace(seen, tracked=replace(seen.tracked, status=status, segment=coasted))
    picture = draw_overlay(GREY, GREY, found, MOUNTING)
    part = picture[380:420, :640].astype(int)
    row = part[20]
    # Half of its width is 1.96 sqrt(0.001) m at 2 m: 15 px of shade between line and border.
    shade = 0.65 * 60 + 0.35 * np.array(_RIGHT_CONTOUR)
    assert 20 <= (np.abs(row - shade).max(axis=1) < 3.0).sum() <= 40
    is_left = (np.abs(part - _LEFT_CONTOUR).max(axis=2) < 50).any(axis=1)
    assert is_left.any()
    assert not is_left.all(), "a broken line has gaps"
    assert not (np.abs(part[:, 320:] - _LEFT_CONTOUR).max(axis=2) < 50).any(), "left is left"


def test_a_film_has_a_title_and_a_legend() -> None:
    plain = draw_overlay(GREY, GREY, result(), MOUNTING)
    titled = draw_overlay(GREY, GREY, result(), MOUNTING, "frame 3")
    foot = slice(455, 480), slice(0, 250)
    assert (plain[foot] == 60).all()
    for colour in (_LEFT_CONTOUR, _RIGHT_CONTOUR, _AXIS):
        assert (np.abs(titled[foot].astype(int) - colour).max(axis=2) < 60).any()


def test_mono_is_one_image_and_nothing_found_has_no_lines() -> None:
    picture = draw_overlay(GREY, None, result(found=False, valid=False), MOUNTING)
    assert picture.shape == (480, 640, 3)
    assert colour_at(picture, 270, 300) == (60, 60, 60)
    assert colour_at(picture, 550, 400) == pytest.approx(_SEGMENTS, abs=20)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, -1e9])
def test_lines_to_nowhere_are_left_out(value: float) -> None:
    found = result()
    assert found.tracked.segment is not None
    contours = np.array([[270, 0, value, 479], [370, 0, 370, 479]], np.float32)
    segment = replace(found.tracked.segment, contours=contours, start=np.array([0, 0, 50.0]))
    picture = draw_overlay(
        GREY, GREY, replace(found, tracked=replace(found.tracked, segment=segment)), MOUNTING
    )
    assert colour_at(picture, 270, 300) == (60, 60, 60)
    assert colour_at(picture, 640 + 370, 300) == _RIGHT_CONTOUR


def test_wide_pictures_are_made_smaller() -> None:
    camera = replace(LEFT, width=4008, height=2672)
    found = result()
    rig = StereoRig(camera, replace(camera, offset=0.2))
    found = replace(found, vectorized=replace(found.vectorized, rig=rig))
    image = np.zeros((2672, 4008), np.uint8)
    assert draw_overlay(image, image, found, MOUNTING).shape == (800, 2400, 3)


def test_dark_pictures_are_made_brighter_for_the_eye() -> None:
    dark = np.tile(np.linspace(20, 80, 640), (480, 1)).astype(np.uint8)
    picture = draw_overlay(dark, dark, result(found=False), MOUNTING)
    row = picture[450, :640, 0].astype(int)
    assert (row[0], row[-1]) == (10, pytest.approx(190, abs=3))
    assert (np.diff(row) >= 0).all()


def test_keeper_keeps_the_best_and_the_middle(tmp_path: Path) -> None:
    keeper = OverlayKeeper(MOUNTING, frame_count=9)
    for index in range(9):
        image = np.full((480, 640), 20 * index, np.uint8)
        keeper.take(image, image, result(quality=0.9 if index == 7 else 0.5))
    paths = keeper.write(tmp_path)
    assert [path.name for path in paths] == ["overlay_best.png", "overlay_middle.png"]
    levels = [np.median(cv2.imread(str(path))) for path in paths]
    assert levels == [140, 80]


def test_keeper_prefers_a_middle_with_a_pipe(tmp_path: Path) -> None:
    keeper = OverlayKeeper(MOUNTING, frame_count=9)
    for index in range(9):
        image = np.full((480, 640), 20 * index, np.uint8)
        keeper.take(image, image, result(valid=index in (2, 8), quality=0.1 * index))
    paths = keeper.write(tmp_path)
    assert [np.median(cv2.imread(str(path))) for path in paths] == [160, 40]
    assert OverlayKeeper(MOUNTING, 0).write(tmp_path) == []
