"""The picture of how honest the covariances are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from pipeline_tracker.benchmark.calibration import _draw, write_calibration
from pipeline_tracker.evaluation.schema import FrameFigures


def frames(count: int, scale: float = 1.0) -> list[FrameFigures]:
    """Frames whose errors are ``scale`` times what their covariance promises."""
    random = np.random.default_rng(1)
    sigmas = np.array([0.01, 0.02, 0.005, 0.004])
    units = scale * random.standard_normal((count, 4))
    return [
        FrameFigures.model_construct(
            valid=True,
            offsets=(unit * sigmas).tolist(),
            sigmas=sigmas.tolist(),
            nees=float(unit[:2] @ unit[:2]),
            direction_nees=float(unit[2:] @ unit[2:]),
        )
        for unit in units
    ]


def test_coverage_and_errors_are_those_of_the_frames() -> None:
    figure = Figure()
    _draw(figure, frames(400, scale=2.0), "default")
    place, _, errors, _ = figure.axes
    # Errors twice too large: 1 - 0.05 ** (1 / 4) of them are inside.
    (dot,) = (one for one in place.get_lines() if one.get_label() == "95 % region")
    np.testing.assert_allclose(dot.get_ydata(), [1.0 - 0.05**0.25], atol=0.06)
    labels = [text.get_text() for text in errors.get_legend().get_texts()]
    rms = [float(label.split("rms ")[1]) for label in labels if "rms" in label]
    np.testing.assert_allclose(rms, [2.0, 2.0], atol=0.2)


def test_one_picture_for_each_variant(tmp_path: Path) -> None:
    written = write_calibration({"default": frames(50), "candidates": frames(5)}, tmp_path)
    assert [path.name for path in written] == [
        "calibration_default.png",
        "calibration_candidates.png",
    ]
    assert all(cv2.imread(str(path)).std() > 10.0 for path in written)
