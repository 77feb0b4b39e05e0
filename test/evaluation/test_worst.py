"""The worst frames: which they are, and the sheet that shows them."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from pipeline_tracker.evaluation import evaluate_command
from pipeline_tracker.evaluation.schema import FrameFigures
from pipeline_tracker.evaluation.worst import WORST, worst_frames
from pipeline_tracker.types import Contours


def frame(
    total: float | None, *, valid: bool = True, detectable: bool = True, false: bool = False
) -> FrameFigures:
    return FrameFigures(
        stamp_ns=0,
        state="tracking" if valid else "searching",
        valid=valid,
        mode="tracking" if valid else "",
        technique=None,
        in_view=True,
        detectable=detectable,
        false_reasons=["end"] if false else [],
        travelled=0.0,
        horizontal=total,
        vertical=total,
        total=total,
        offsets=None,
        sigmas=None,
        nees=None,
        direction_nees=None,
        covered=None,
        errors={},
        error_sigmas={},
        contours_px={},
        visible_contours_px={},
    )


def test_false_ones_first_then_missed_ones_then_the_greatest_divergence() -> None:
    frames = [
        frame(0.01),
        frame(None, valid=False),
        frame(0.03),
        frame(0.2, false=True),
        frame(None, valid=False, detectable=False),
        frame(0.02),
    ]
    assert worst_frames(frames, 10) == [3, 1, 2, 5, 0]
    assert worst_frames(frames, 2) == [3, 1]


def test_nothing_to_look_at() -> None:
    assert worst_frames([frame(None, valid=False, detectable=False)], 3) == []


def test_the_sheet_shows_the_worst_with_truth_and_words(sea: Any, tmp_path: Path) -> None:
    sea.images = [np.full((128, 160), 90, np.uint8)] * 12
    frames = sea.frames()
    frames[4] = frames[4].moved(np.array([0.0, 0.0, 0.2]))
    segment = replace(
        frames[4].segment,
        visible_contours=Contours.LEFT_IMAGE_RIGHT | Contours.RIGHT_IMAGE_LEFT,
        contours=np.array([[100, 10, 120, 120], [30, 10, 30, 120]], np.float32),
    )
    frames[4] = replace(frames[4], segment=segment)
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", frames)
    text = io.StringIO()
    evaluate_command(directory, truth, Console(file=text, width=200), plots=False, worst=3)
    assert WORST in text.getvalue()
    sheet = cv2.imread(str(directory / WORST))
    # Three tiles of 800 x 640 in two columns, the fourth place empty.
    assert sheet.shape == (1280, 1600, 3)
    assert not sheet[640:, 800:].any()
    for tile in (sheet[:640, :800], sheet[:640, 800:], sheet[640:, :800]):
        assert (tile == 255).all(axis=2).any(), "no letters"
    # The left image's contour of the first, red; not that of the right image.
    blue, _, red = np.moveaxis(sheet[:640, :800].astype(int), 2, 0)
    columns = np.nonzero((red - blue > 100).any(axis=0))[0]
    assert 495 < columns.min() < columns.max() < 610


def test_without_images_there_is_no_sheet(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth", leave_out=("/stereo/left/image_rect",))
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    evaluate_command(directory, truth, Console(file=io.StringIO()), plots=False, worst=3)
    assert not (directory / WORST).exists()
