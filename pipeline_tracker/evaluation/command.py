"""Evaluate a replay: read both sides, see that they belong together, measure, write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.figures import Evaluation, count, group_figures
from pipeline_tracker.evaluation.frames import Judge
from pipeline_tracker.evaluation.replay import Replay, read_replay
from pipeline_tracker.evaluation.table import print_evaluation
from pipeline_tracker.evaluation.truth import Truth, read_truth

FILE_NAME = "evaluation.json"

# Mean difference of two thumbnails of one image, grey levels: decoders differ by less. Another sea
# differs by more, as does another frame of the same.
_SAME_IMAGE = 2.0


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
    replay = read_replay(replay_dir)
    truth = read_truth(truth_bag, replay.settings, replay.thumbnails.keys())
    compared = check_fit(replay, truth)
    judge = Judge(replay, truth)
    frames = [judge.judge(estimate) for estimate in replay.estimates]
    return Evaluation(
        replay=str(replay_dir),
        truth=str(truth_bag),
        images_compared=compared,
        counts=count(frames),
        groups=group_figures(frames),
    )


def evaluate_command(replay_dir: Path, truth_bag: Path, console: Console | None = None) -> None:
    """Evaluate, write ``evaluation.json`` into the replay's directory and print the tables.

    Args:
        replay_dir, truth_bag: see ``evaluate``.
        console: where to print; standard output by default.

    Raises:
        EvaluationError: as ``evaluate``, or the file cannot be written.
        BagError, SettingsError: as ``evaluate``.
    """
    evaluation = evaluate(replay_dir, truth_bag)
    path = replay_dir / FILE_NAME
    try:
        path.write_text(evaluation.model_dump_json(indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise EvaluationError(f"{path}: cannot be written ({error.strerror})") from None
    console = console or Console()
    print_evaluation(evaluation, console)
    console.print(f"written to {path}", highlight=False, soft_wrap=True)


def check_fit(replay: Replay, truth: Truth) -> int:
    """See that a truth belongs to a replay.

    Args:
        replay: the replay.
        truth: the truth.

    Returns:
        Number of frames whose images were compared.

    Raises:
        EvaluationError: frames have no true pose, or the bag's images are not those replayed.
    """
    stamps = [estimate.stamp_ns for estimate in replay.estimates]
    missing = [stamp for stamp in stamps if truth.poses.at(stamp) is None]
    if missing:
        raise EvaluationError(
            f"{truth.path}: the truth does not fit the replay {replay.directory}: "
            f"{len(missing)} of its {len(stamps)} frames have no true pose (the first has the "
            f"stamp {missing[0]} ns); expected the bag that was replayed"
        )
    compared = 0
    for stamp, seen in replay.thumbnails.items():
        there = truth.thumbnails.get(stamp)
        if there is None:
            continue
        differs = there.shape != seen.shape or _difference(there, seen) > _SAME_IMAGE
        if differs:
            raise EvaluationError(
                f"{truth.path}: the truth does not fit the replay {replay.directory}: its left "
                f"image of stamp {stamp} ns is another one; expected the bag that was replayed"
            )
        compared += 1
    return compared


def _difference(first: NDArray[Any], second: NDArray[Any]) -> float:
    return float(np.abs(first.astype(np.int16) - second.astype(np.int16)).mean())
