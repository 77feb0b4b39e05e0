"""The plots show what evaluation.json holds."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation import Evaluation, evaluate
from pipeline_tracker.evaluation.plots import (
    PLOTS,
    draw_coverage,
    draw_errors,
    draw_states,
    write_plots,
)
from pipeline_tracker.types import State


@pytest.fixture
def evaluation(sea: Any, tmp_path: Path) -> Evaluation:
    """Frame 2 false valid, 5 and 6 coasting, 7 searching."""
    frames = [f.moved(np.array([0.0, 0.001 * i, 0.002])) for i, f in enumerate(sea.frames())]
    frames[2] = frames[2].moved(np.array([0.0, 0.0, 0.08]))
    for i in (5, 6):
        frames[i] = replace(frames[i], state=State.COASTING)
    frames[7] = replace(frames[7], state=State.SEARCHING, segment=None)
    truth = sea.write_truth(tmp_path / "truth")
    return evaluate(sea.write_replay(tmp_path / "replay", frames), truth)


def line(axes: Any, label: str) -> Any:
    (found,) = (one for one in axes.get_lines() if one.get_label() == label)
    return found


def test_errors_are_drawn_over_the_way(evaluation: Evaluation) -> None:
    figure = Figure()
    draw_errors(evaluation, figure)
    frames = evaluation.per_frame
    total, left, up, heading = figure.axes
    valid = line(up, "error, valid frames")
    np.testing.assert_allclose(valid.get_xdata(), [f.travelled for f in frames])
    expected = [100.0 * f.offsets[1] if f.valid and f.offsets else np.nan for f in frames]
    np.testing.assert_allclose(valid.get_ydata(), expected)
    assert np.isnan(expected).sum() == 3
    carried = line(up, "coasting").get_ydata()
    assert np.flatnonzero(np.isfinite(carried)).tolist() == [5, 6]
    (crossed,) = line(up, "false valid").get_xdata()
    assert crossed == frames[2].travelled
    horizontal = line(total, "divergence, horizontal").get_ydata()
    assert horizontal[3] == pytest.approx(100.0 * frames[3].horizontal)
    assert heading.get_ylabel() == "error heading, deg"
    (band,) = (one for one in left.collections if one.get_label().startswith("±1.96"))
    # Sigma is 1 cm.
    assert band.get_datalim(left.transData).ymax == pytest.approx(1.96)


def test_coverage_is_drawn_as_it_is_counted(evaluation: Evaluation) -> None:
    figure = Figure()
    draw_coverage(evaluation, figure)
    position, direction = figure.axes
    (share,) = line(position, "95 % region").get_ydata()
    assert share == evaluation.groups["all"].coverage_95.share < 1.0
    observed = line(position, "observed")
    for level, expected in evaluation.groups["all"].coverage_95.levels.items():
        drawn = np.interp(float(level) / 100.0, observed.get_xdata(), observed.get_ydata())
        assert drawn == pytest.approx(expected, abs=0.12)
    assert "of 9 in the 95 % region" in direction.get_title()


def test_states_are_drawn_by_frame(evaluation: Evaluation) -> None:
    figure = Figure()
    draw_states(evaluation, figure)
    (axes,) = figure.axes
    names = [text.get_text() for text in axes.get_yticklabels()]
    bars = dict.fromkeys(names, 0)
    for collection in axes.collections:
        for path in collection.get_paths():
            bars[names[round(float(path.vertices[:, 1].mean()))]] += 1
    assert bars == {
        "pipe in view": 12,
        "tracking": 9,
        "coasting": 2,
        "searching": 1,
        "recognised": 1,
        "valid": 9,
        "false valid": 1,
    }


def test_plots_are_written_as_pictures(evaluation: Evaluation, tmp_path: Path) -> None:
    written = write_plots(evaluation, tmp_path)
    assert [path.name for path in written] == list(PLOTS)
    for path in written:
        picture = cv2.imread(str(path))
        assert picture.shape[1] == 1080
        assert picture.std() > 10.0
    with pytest.raises(EvaluationError, match="cannot be written"):
        write_plots(evaluation, tmp_path / "nowhere")


@pytest.mark.parametrize("count", [1, 3])
def test_plots_of_a_replay_that_found_nothing(make_sea: Any, tmp_path: Path, count: int) -> None:
    sea = make_sea(count=count)
    # It does not even move.
    sea.poses = sea.poses[:1] * count
    frames = [replace(f, state=State.SEARCHING, segment=None) for f in sea.frames()]
    truth = sea.write_truth(tmp_path / "truth")
    evaluation = evaluate(sea.write_replay(tmp_path / "replay", frames), truth)
    assert len(write_plots(evaluation, tmp_path)) == 3
    figure = Figure()
    draw_errors(evaluation, figure)
    assert figure.axes[-1].get_xlabel() == "frame"
    assert figure.axes[0].texts[0].get_text() == "no frame with an estimate and a pipe"


def test_matplotlib_is_loaded_for_plots_alone() -> None:
    code = "import sys, pipeline_tracker.evaluation; print('matplotlib' in sys.modules)"
    output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    assert output.stdout.split() == [b"False"]
