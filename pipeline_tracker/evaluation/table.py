"""An evaluation as tables for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.console import Console
from rich.table import Table

from pipeline_tracker.evaluation.schema import Counts, Evaluation, MeanMax, SignedError

_TITLES = {
    "all": "all valid",
    "tracking": "tracking",
    "recognition": "recognition",
    "technique_1": "  technique 1",
    "technique_2": "  technique 2",
    "technique_3": "  technique 3",
    "technique_4": "  technique 4",
    "coasting": "coasting (not valid)",
}
_ERRORS = {
    "heading_misalignment": ("heading", "deg", math.degrees(1.0)),
    "pitch_misalignment": ("pitch", "deg", math.degrees(1.0)),
    "min_distance": ("distance", "cm", 100.0),
    "lateral_offset": ("lateral offset", "cm", 100.0),
    "approach_speed": ("approach speed", "cm/s", 100.0),
}


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Print an evaluation."""
    for line in _counts(evaluation.counts):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(_divergence(evaluation))
    console.print(_errors(evaluation))


def _counts(counts: Counts) -> Iterator[str]:
    yield _share("frames", counts.valid, counts.frames)
    if counts.in_view is not None:
        yield _share("frames with the pipe in view", counts.in_view_valid, counts.in_view)
    if counts.detectable is None:
        yield "detectable frames not known: the bag does not tell which contours are hidden"
    else:
        yield _share("detectable frames", counts.detectable_valid, counts.detectable)
    reasons = ", ".join(f"{k} {n}" for k, n in counts.false_valid_reasons.items())
    yield f"{counts.false_valid} frames false valid{f' ({reasons})' if reasons else ''}"


def _share(what: str, valid: int | None, of: int) -> str:
    share = f" ({_percent(valid / of)})" if valid is not None and of else ""
    return f"{valid} of {of} {what} valid{share}"


def _divergence(evaluation: Evaluation) -> Table:
    table = Table(title="Divergence, sum of both ends, cm: average / max")
    for name in ("", "frames", "horizontal", "vertical", "distance", "in 95 %"):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    for name, group in evaluation.groups.items():
        d, share = group.divergence, group.coverage_95.share
        table.add_row(
            _TITLES[name],
            str(group.frames),
            *(_pair(part) for part in (d.horizontal, d.vertical, d.total)),
            "-" if share is None else _percent(share),
        )
    return table


def _errors(evaluation: Evaluation) -> Table:
    table = Table(title="Errors, estimate less truth, all valid frames")
    for name in ("", "unit", "frames", "mean", "rms", "extreme"):
        table.add_column(name, justify="left" if name in ("", "unit") else "right", no_wrap=True)
    for column, error in evaluation.groups["all"].errors.items():
        title, unit, scale = _ERRORS[column]
        table.add_row(title, unit, str(error.frames), *_signed(error, scale))
    return table


def _pair(part: MeanMax) -> str:
    if part.mean is None or part.max is None:
        return "-"
    return f"{100.0 * part.mean:.2f} / {100.0 * part.max:.2f}"


def _signed(error: SignedError, scale: float) -> Iterator[str]:
    for value, sign in ((error.mean, "+"), (error.rms, ""), (error.extreme, "+")):
        yield "-" if value is None else f"{scale * value:{sign}.2f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
