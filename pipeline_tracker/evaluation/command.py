"""Evaluate a replay: read both sides, see that they belong together, measure, write."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.figures import count, frame_figures, group_figures
from pipeline_tracker.evaluation.fit import check_fit
from pipeline_tracker.evaluation.frames import Judge
from pipeline_tracker.evaluation.plots import write_plots
from pipeline_tracker.evaluation.replay import Replay, read_replay
from pipeline_tracker.evaluation.schema import Evaluation, Setup
from pipeline_tracker.evaluation.searches import finding
from pipeline_tracker.evaluation.table import print_evaluation
from pipeline_tracker.evaluation.truth import Truth, read_truth
from pipeline_tracker.evaluation.worst import write_worst

FILE_NAME = "evaluation.json"


def evaluate(replay_dir: Path, truth_bag: Path) -> Evaluation:
    """Measure a replay against the truth, by the paper's measure (5.1, 5.2).

    An estimate is placed in the world by the true pose of base_link and measured to the nearest
    point of the true axis.

    Args:
        replay_dir: output directory of a replay.
        truth_bag: bag with ``/ground_truth/pose`` and ``/ground_truth/centerline``.

    Raises:
        EvaluationError: there is no replay or no truth, or they do not belong together.
        BagError: a bag cannot be read.
        SettingsError: the replay's settings cannot be read.
    """
    return _measured(*_read(replay_dir, truth_bag))


def _read(replay_dir: Path, truth_bag: Path) -> tuple[Replay, Truth]:
    replay = read_replay(replay_dir)
    truth = read_truth(truth_bag, replay.settings, replay.thumbnails.keys(), replay.rig)
    return replay, truth


def _measured(replay: Replay, truth: Truth) -> Evaluation:
    fit = check_fit(replay, truth)
    judge = Judge(replay, truth)
    frames = [judge.judge(estimate) for estimate in replay.estimates]
    return Evaluation(
        replay=str(replay.directory),
        truth=str(truth.path),
        fit=fit,
        setup=_setup(replay, truth),
        counts=count(frames),
        finding=finding(frames),
        groups=group_figures(frames),
        per_frame=frame_figures(frames),
    )


def evaluate_command(
    replay_dir: Path,
    truth_bag: Path,
    console: Console | None = None,
    *,
    plots: bool = True,
    worst: int = 0,
) -> None:
    """Evaluate, write ``evaluation.json`` and plots into the replay's directory, print the tables.

    Args:
        replay_dir, truth_bag: see ``evaluate``.
        console: where to print; standard output by default.
        plots: whether to write the plots.
        worst: of how many frames, the worst ones, to write a contact sheet.

    Raises:
        EvaluationError: as ``evaluate``, or a file cannot be written.
        BagError, SettingsError: as ``evaluate``.
    """
    replay, truth = _read(replay_dir, truth_bag)
    evaluation = _measured(replay, truth)
    path = replay_dir / FILE_NAME
    try:
        path.write_text(evaluation.model_dump_json(indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise EvaluationError(f"{path}: cannot be written ({error.strerror})") from None
    written = [path, *(write_plots(evaluation, replay_dir) if plots else ())]
    sheet = write_worst(replay, truth, evaluation.per_frame, worst) if worst else None
    written += [] if sheet is None else [sheet]
    console = console or Console()
    print_evaluation(evaluation, console)
    names = ", ".join(file.name for file in written)
    console.print(f"Written to {replay_dir}: {names}", highlight=False, soft_wrap=True)


def _setup(replay: Replay, truth: Truth) -> Setup:
    settings, rig, mounting = replay.settings, truth.rig, truth.mounting
    left = None if rig is None else rig.left
    return Setup(
        pipe_diameter=2.0 * settings.radius,
        true_pipe_diameter=None if truth.radius is None else 2.0 * truth.radius,
        technique=str(settings.recognition.technique),
        recognition_only=settings.recognition.only,
        image_size=None if left is None else [left.width, left.height],
        field_of_view=None if left is None else 2.0 * math.atan(left.width / (2.0 * left.fx)),
        baseline=None if rig is None else rig.baseline,
        mounting_translation=None if mounting is None else mounting.translation.tolist(),
        mounting_rpy=None if mounting is None else mounting.rpy().tolist(),
        scenario=truth.scenario,
    )
