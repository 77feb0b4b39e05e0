"""Blunders that a measure must not make, on replays whose errors are known."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from pipeline_tracker.errors import BagError, EvaluationError
from pipeline_tracker.evaluation import (
    Evaluation,
    evaluate,
    evaluate_command,
    evaluation_schema,
)
from pipeline_tracker.evaluation.plots import PLOTS
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import State

OTHER_STATES = (State.SEARCHING, State.COASTING)


def measure(sea: Any, tmp_path: Path, frames: list[Any], **options: Any) -> Evaluation:
    truth = sea.write_truth(tmp_path / "truth")
    return evaluate(sea.write_replay(tmp_path / "replay", frames, **options), truth)


def test_estimates_made_from_the_truth_have_no_error(sea: Any, tmp_path: Path) -> None:
    result = measure(sea, tmp_path, sea.frames())
    assert result.counts.valid == result.counts.frames == 12
    assert result.counts.false_valid == 0
    figures = result.groups["all"]
    assert figures.frames == 12
    for part in (figures.divergence.horizontal, figures.divergence.vertical):
        assert part.max == pytest.approx(0.0, abs=1e-8)
    # The two ways to compute them, of the method and of its measure, agree.
    for name, error in figures.errors.items():
        assert error.extreme == pytest.approx(0.0, abs=1e-6), name
    assert figures.errors["heading_misalignment"].frames == 12
    # In the first second the motion is not known yet.
    assert figures.errors["approach_speed"].frames == 10
    assert figures.coverage_95.frames == 12
    assert figures.coverage_95.share == 1.0


def test_a_replay_shifted_sideways_by_1_cm_is_off_by_1_cm_at_each_end(
    sea: Any, tmp_path: Path
) -> None:
    # Square to the axis at each frame's segment; the pipe is bent, and climbs.
    frames = []
    for frame in sea.frames():
        way = frame.pose.rotate(frame.segment.end - frame.segment.start)
        aside = np.array([-way[1], way[0], 0.0]) / math.hypot(way[0], way[1])
        frames.append(frame.moved(0.01 * aside))
    divergence = measure(sea, tmp_path, frames).groups["all"].divergence
    assert divergence.horizontal.mean == pytest.approx(0.02, rel=2e-3)
    assert divergence.horizontal.max == pytest.approx(0.02, rel=2e-3)
    assert divergence.vertical.max == pytest.approx(0.0, abs=1e-4)


def test_a_replay_shifted_upwards_on_a_level_pipe_is_off_vertically(
    sea: Any, tmp_path: Path
) -> None:
    sea.centerline[:, 2] = 0.2
    frames = [frame.moved(np.array([0.0, 0.0, 0.01])) for frame in sea.frames()]
    figures = measure(sea, tmp_path, frames).groups["all"]
    assert figures.divergence.vertical.mean == pytest.approx(0.02)
    assert figures.divergence.horizontal.max == pytest.approx(0.0, abs=1e-8)
    assert figures.divergence.total.mean == pytest.approx(0.02)


def test_a_shift_along_the_pipe_is_no_error(sea: Any, tmp_path: Path) -> None:
    sea.centerline[:, 1] = 0.1
    sea.centerline[:, 2] = 0.2
    # By less than the spacing of the true vertices: between them is axis too.
    frames = [frame.moved(np.array([0.013, 0.0, 0.0])) for frame in sea.frames()]
    figures = measure(sea, tmp_path, frames).groups["all"]
    assert figures.divergence.total.max == pytest.approx(0.0, abs=1e-8)


def test_errors_have_the_sign_of_estimate_less_truth(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    added = {
        "heading_misalignment": 0.02,
        "pitch_misalignment": -0.01,
        "min_distance": 0.05,
        "approach_speed": -0.03,
        "lateral_offset": 0.04,
    }
    change_table(directory, lambda row: {n: add(row[n], value) for n, value in added.items()})
    errors = evaluate(directory, truth).groups["all"].errors
    for name, value in added.items():
        assert errors[name].mean == pytest.approx(value, abs=1e-6)
        assert errors[name].extreme == pytest.approx(value, abs=1e-6)
        assert errors[name].rms == pytest.approx(abs(value), abs=1e-6)


def test_headings_on_both_sides_of_180_degrees_are_near(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    turn = 2.0 * math.pi
    change_table(
        directory,
        lambda row: {"heading_misalignment": add(row["heading_misalignment"], turn + 0.01)},
    )
    error = evaluate(directory, truth).groups["all"].errors["heading_misalignment"]
    assert error.mean == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize("state", OTHER_STATES)
def test_frames_without_a_valid_estimate_never_improve_a_mean(
    sea: Any, tmp_path: Path, state: State
) -> None:
    frames = [frame.moved(np.array([0.0, 0.0, 0.01])) for frame in sea.frames()]
    everywhere = measure(sea, tmp_path / "a", frames)
    fewer = [
        replace(f, state=state, segment=None if state == State.SEARCHING else f.segment)
        if i % 2
        else f
        for i, f in enumerate(frames)
    ]
    half = measure(sea, tmp_path / "b", fewer)
    assert half.counts.valid == 6
    assert half.counts.valid_share == 0.5
    assert half.groups["all"].frames == 6
    assert half.groups["all"].divergence.total.mean == pytest.approx(
        everywhere.groups["all"].divergence.total.mean, rel=0.05
    )
    assert ("coasting" in half.groups) == (state == State.COASTING)


def test_modes_and_techniques_are_counted_apart(sea: Any, tmp_path: Path) -> None:
    frames = sea.frames()
    frames[0] = frames[0].moved(np.array([0.0, 0.0, 0.03]))
    groups = measure(sea, tmp_path, frames).groups
    assert set(groups) == {"all", "tracking", "recognition", "technique_2"}
    assert groups["tracking"].frames == 11
    assert groups["tracking"].divergence.total.max == pytest.approx(0.0, abs=1e-8)
    assert groups["recognition"].divergence == groups["technique_2"].divergence
    assert groups["technique_2"].divergence.total.mean == pytest.approx(0.06, rel=0.01)


def test_false_valid_by_an_end(sea: Any, tmp_path: Path) -> None:
    frames = sea.frames()
    frames[3] = frames[3].moved(np.array([0.0, 0.06, 0.0]))
    frames[5] = frames[5].moved(np.array([0.0, 0.045, 0.0]))
    counts = measure(sea, tmp_path, frames).counts
    assert counts.false_valid_stamps == [sea.stamps[3]]
    assert counts.false_valid_reasons == {"end": 1}


def test_beyond_3_m_an_end_may_be_off_by_10_cm(sea: Any, tmp_path: Path) -> None:
    sea.centerline[:, 2] -= 1.5
    frames = sea.frames()
    frames[3] = frames[3].moved(np.array([0.0, 0.06, 0.0]))
    frames[5] = frames[5].moved(np.array([0.0, 0.12, 0.0]))
    assert measure(sea, tmp_path, frames).counts.false_valid_stamps == [sea.stamps[5]]


def test_false_valid_by_the_direction(sea: Any, tmp_path: Path) -> None:
    frames = sea.frames()
    for index, degrees in ((2, 3.5), (4, 2.5)):
        segment = frames[index].segment
        half = (segment.end - segment.start) / 2.0
        aside = np.cross(half, [0.0, 0.0, 1.0]) * math.tan(math.radians(degrees))
        frames[index] = replace(
            frames[index],
            segment=replace(segment, start=segment.start - aside, end=segment.end + aside),
        )
    counts = measure(sea, tmp_path, frames).counts
    assert counts.false_valid_stamps == [sea.stamps[2]]
    assert counts.false_valid_reasons == {"direction": 1}


def test_without_a_pipe_every_valid_frame_is_false(sea: Any, tmp_path: Path) -> None:
    frames = sea.frames()
    sea.centerline = np.zeros((0, 3))
    result = measure(sea, tmp_path, frames)
    assert result.counts.false_valid == 12
    assert result.counts.false_valid_reasons == {"no_pipe_in_view": 12}
    assert result.counts.in_view == result.counts.detectable == 0
    assert result.counts.detectable_valid_share is None
    assert result.groups["all"].frames == 0
    assert result.groups["all"].divergence.total.mean is None


def test_a_pipe_that_no_camera_has_in_view_makes_valid_frames_false(
    sea: Any, tmp_path: Path
) -> None:
    frames = sea.frames()
    # The true pipe is 40 m to starboard; the estimates are its parallels below the vehicle.
    sea.centerline[:, 1] -= 40.0
    counts = measure(sea, tmp_path, frames).counts
    assert counts.in_view == 0
    assert counts.false_valid_reasons["no_pipe_in_view"] == 12


def test_what_is_hidden_decides_what_is_detectable(sea: Any, tmp_path: Path) -> None:
    x = np.linspace(0.0, 100.0, 101)
    line = np.stack((x, np.full(101, 50.0)), axis=1)
    pixels = np.stack((line, line))
    sea.contours = []
    for i in range(12):
        flags = np.ones((2, 101))
        # Hidden; a fifth visible, which is too little; three tenths of one contour.
        flags[1, : (0, 21, 31)[i % 3]] = 2
        sea.contours.append((pixels, flags))
    frames = [
        replace(f, state=State.SEARCHING, segment=None) if i == 2 else f
        for i, f in enumerate(sea.frames())
    ]
    counts = measure(sea, tmp_path, frames).counts
    assert counts.detectable == 4
    assert counts.detectable_valid == 3
    assert counts.detectable_valid_share == 0.75


def test_without_contours_in_the_bag_detectable_is_not_known(sea: Any, tmp_path: Path) -> None:
    counts = measure(sea, tmp_path, sea.frames()).counts
    assert counts.detectable is None
    assert counts.in_view == counts.in_view_valid == 12


def test_coverage_is_the_share_inside_the_region(sea: Any, tmp_path: Path) -> None:
    # Sigma is 1 cm: 95 % lie within 2.45 cm of both offsets together.
    sea.centerline[:, 1], sea.centerline[:, 2] = 0.1, 0.2
    frames = sea.frames()
    for i, offset in enumerate((0.024, 0.025, 0.030)):
        frames[i] = frames[i].moved(np.array([0.0, offset, 0.0]))
    assert measure(sea, tmp_path, frames).groups["all"].coverage_95.share == 10 / 12


def test_without_the_result_bag_the_table_is_measured_alone(sea: Any, tmp_path: Path) -> None:
    figures = measure(sea, tmp_path, sea.frames(), result=False).groups["all"]
    assert figures.coverage_95.frames == 0
    assert figures.coverage_95.share is None
    assert figures.errors["heading_misalignment"].extreme == pytest.approx(0.0, abs=1e-6)


def test_going_astern_is_measured_by_the_same_direction(sea: Any, tmp_path: Path) -> None:
    # Ahead for a second and a half, then back: the direction is turned on the way.
    there = sea.poses[:4]
    sea.poses = [*there, *(there[0] @ Pose.from_rpy([-0.3 * i, 0, 0], [0, 0, 0]) for i in range(8))]
    frames = sea.frames()
    result = measure(sea, tmp_path, frames)
    error = result.groups["all"].errors["heading_misalignment"]
    assert error.frames == 12
    assert error.extreme == pytest.approx(0.0, abs=1e-6)
    rows = list(csv.DictReader((tmp_path / "replay" / "estimates.csv").open()))
    turned = [abs(float(row["heading_misalignment"])) > 2.0 for row in rows]
    assert any(turned)
    assert not turned[-1]


def test_after_a_reset_the_direction_is_chosen_anew(sea: Any, tmp_path: Path) -> None:
    sea.poses = [
        Pose.from_rpy([-0.3 * i, 0.5, 2.5], [0.0, 0.0, 0.0 if i < 6 else math.pi])
        for i in range(12)
    ]
    frames = [replace(f, reset_counter=int(i >= 6)) for i, f in enumerate(sea.frames())]
    error = measure(sea, tmp_path, frames).groups["all"].errors["heading_misalignment"]
    assert error.frames == 12
    assert error.extreme == pytest.approx(0.0, abs=1e-6)


def test_frames_without_pose_are_measured_from_the_bow(sea: Any, tmp_path: Path) -> None:
    sea.poses = [Pose.from_rpy([0.25 * i, 0.5, 2.5], [0.0, 0.0, 0.3 * i]) for i in range(12)]
    frames = [replace(f, has_pose=False) for f in sea.frames()]
    errors = measure(sea, tmp_path, frames).groups["all"].errors
    for name in ("heading_misalignment", "pitch_misalignment", "lateral_offset"):
        assert errors[name].frames == 12
        assert errors[name].extreme == pytest.approx(0.0, abs=1e-6), name
    assert errors["approach_speed"].frames == 0


# What does not belong together


def test_a_truth_with_other_stamps_is_refused(
    sea: Any, make_sea: Callable[..., Any], tmp_path: Path
) -> None:
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    other = make_sea(start_ns=1_800_000_000_000_000_000).write_truth(tmp_path / "other")
    with pytest.raises(EvaluationError, match=r"does not fit.* 12 of its 12 frames have no true"):
        evaluate(directory, other)


def test_a_truth_that_ends_too_early_is_refused(
    sea: Any, make_sea: Callable[..., Any], tmp_path: Path
) -> None:
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    short = make_sea(count=11).write_truth(tmp_path / "short")
    with pytest.raises(EvaluationError, match="1 of its 12 frames"):
        evaluate(directory, short)


def test_another_sea_with_the_same_stamps_is_refused(
    sea: Any, make_sea: Callable[..., Any], tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    sea.images = list(rng.integers(0, 255, (12, 128, 160), dtype=np.uint8))
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    assert evaluate(directory, sea.write_truth(tmp_path / "own")).fit.images_compared == 5
    other = make_sea()
    other.images = list(rng.integers(0, 255, (12, 128, 160), dtype=np.uint8))
    with pytest.raises(EvaluationError, match=r"left image of stamp .* is another one"):
        evaluate(directory, other.write_truth(tmp_path / "other"))


def test_a_bag_without_truth_is_refused(sea: Any, tmp_path: Path) -> None:
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    with pytest.raises(EvaluationError, match="no truth in this bag, /ground_truth/pose"):
        evaluate(directory, directory / "result")


def test_a_missing_truth_is_refused(sea: Any, tmp_path: Path) -> None:
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    with pytest.raises(BagError, match="no such file"):
        evaluate(directory, tmp_path / "nowhere")


@pytest.mark.parametrize("missing", ["estimates.csv", "settings.yaml"])
def test_what_is_no_replay_is_refused(sea: Any, tmp_path: Path, missing: str) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    (directory / missing).unlink()
    with pytest.raises(EvaluationError, match=f"no {missing} in it"):
        evaluate(directory, truth)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"start_x": "nan"}, "line 2: nan is not a finite number"),
        ({"valid": "yes"}, "line 2: .*invalid literal"),
        ({"start_x": "", "start_y": "", "start_z": ""}, "line 2: a valid row without a segment"),
    ],
)
def test_a_damaged_table_is_refused(
    sea: Any, tmp_path: Path, change: dict[str, str], text: str
) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    change_table(directory, lambda _: change)
    with pytest.raises(EvaluationError, match=text):
        evaluate(directory, truth)


def test_an_empty_table_is_refused(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    with pytest.raises(EvaluationError, match="it has no rows"):
        evaluate(sea.write_replay(tmp_path / "replay", [], result=False), truth)


# What is written


def test_the_command_writes_json_that_its_schema_describes(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    text = io.StringIO()
    evaluate_command(directory, truth, Console(file=text, width=100))
    raw = (directory / "evaluation.json").read_text()
    assert Evaluation.model_validate_json(raw) == evaluate(directory, truth)
    assert "NaN" not in raw
    written, schema = json.loads(raw), evaluation_schema()
    assert set(written) == set(schema["properties"])
    assert written["counts"].keys() == schema["$defs"]["Counts"]["properties"].keys()
    assert all((directory / name).is_file() for name in PLOTS)
    printed = text.getvalue()
    assert "12 of 12 frames valid (100.0 %)" in printed
    assert "technique 2" in printed
    assert "heading" in printed


def test_tables_are_printed_where_nothing_was_found(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    frames = [replace(f, state=State.SEARCHING, segment=None) for f in sea.frames()]
    directory = sea.write_replay(tmp_path / "replay", frames)
    text = io.StringIO()
    evaluate_command(directory, truth, Console(file=text, width=80), plots=False)
    assert not list(directory.glob("*.png"))
    assert "0 of 12 frames valid (0.0 %)" in text.getvalue()
    assert json.loads((directory / "evaluation.json").read_text())["counts"]["valid"] == 0


def test_tables_fit_80_columns(sea: Any, tmp_path: Path) -> None:
    sea.images = [np.zeros((128, 160), np.uint8)] * 12
    frames = [f.moved(np.array([0.0, 0.321, -0.654])) for f in sea.frames()]
    frames[3] = replace(frames[3], state=State.COASTING)
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", frames)
    text = io.StringIO()
    evaluate_command(directory, truth, Console(file=text, width=80), plots=False)
    *tables, last = text.getvalue().splitlines()
    assert last.startswith("Written to ")
    assert max(map(len, tables)) <= 80
    assert "…" not in text.getvalue()
    for words in ("coasting, invalid", "right image right", "missed", "11 frames false valid"):
        assert words in text.getvalue()


def test_the_scenario_stands_beside_the_figures(sea: Any, tmp_path: Path) -> None:
    truth = sea.write_truth(tmp_path / "truth")
    sea.scenario = "pipe: {diameter: 0.61}\nlamps: [{position: [0.5, 0.0, 0.0]}]\n"
    told = sea.write_truth(tmp_path / "told")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    plain, result = evaluate(directory, truth), evaluate(directory, told)
    assert plain.setup.scenario is None
    assert result.setup.scenario == {
        "pipe": {"diameter": 0.61},
        "lamps": [{"position": [0.5, 0.0, 0.0]}],
    }
    assert result.setup.true_pipe_diameter == 0.61
    # The surface of the true pipe is half a centimetre nearer.
    before, after = (e.groups["all"].errors["min_distance"].mean for e in (plain, result))
    assert after - before == pytest.approx(0.005)
    text = io.StringIO()
    evaluate_command(directory, told, Console(file=text, width=200), plots=False)
    assert "pipe 0.6 m (in truth 0.61 m); 160 x 128 px, 43.6 deg wide" in text.getvalue()
    assert "1 lamp at [0.5, 0.0, 0.0] m" in text.getvalue()


def test_a_scenario_that_is_no_yaml_is_refused(sea: Any, tmp_path: Path) -> None:
    sea.scenario = "pipe: [\n"
    truth = sea.write_truth(tmp_path / "truth")
    directory = sea.write_replay(tmp_path / "replay", sea.frames())
    with pytest.raises(EvaluationError, match="/ground_truth/scenario cannot be read"):
        evaluate(directory, truth)


def add(cell: str, value: float) -> str:
    return repr(float(cell) + value) if cell else ""


def change_table(directory: Path, change: Callable[[dict[str, str]], dict[str, str]]) -> None:
    path = directory / "estimates.csv"
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        names, rows = list(reader.fieldnames or ()), list(reader)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, names, lineterminator="\n")
        table.writeheader()
        table.writerows([{**row, **change(row)} for row in rows])
