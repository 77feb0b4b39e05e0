"""report.html: one file that needs nothing else."""

from __future__ import annotations

from pathlib import Path

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.schema import Evaluation
from pipeline_tracker.report.facts import read_document
from pipeline_tracker.report.page import page
from pipeline_tracker.report.record import Record, read_record

FILE_NAME = "report.html"
_EVALUATION = "evaluation.json"


def write_report(directory: Path, evaluation: Evaluation | None = None) -> Path:
    """Write the report on a replay, from what it left in its directory.

    Args:
        directory: output of a replay.
        evaluation: its errors; by default those of ``evaluation.json``, where that is there.

    Returns:
        The path of the page.

    Raises:
        BagError: it is not a replay's output, or a file in it is damaged.
        SettingsError: its settings are.
        EvaluationError: its evaluation.json is damaged, or of another replay.
        OSError: the page cannot be written.
    """
    record = read_record(directory)
    if evaluation is None:
        evaluation = _read_evaluation(record)
    path = directory / FILE_NAME
    # A reader never finds half a page.
    beside = path.with_suffix(".html.tmp")
    beside.write_text(page(record, evaluation), encoding="utf-8", errors="replace")
    beside.replace(path)
    return path


def _read_evaluation(record: Record) -> Evaluation | None:
    path = record.directory / _EVALUATION
    evaluation = read_document(path, Evaluation, EvaluationError, "evaluate again")
    if evaluation is None:
        return None
    stamps = [frame.stamp_ns for frame in evaluation.per_frame]
    if stamps != [int(row["stamp_ns"]) for row in record.rows]:
        raise EvaluationError(
            f"{path}: it is of another replay, its frames are not those of estimates.csv; "
            "evaluate again, or delete it"
        )
    return evaluation
