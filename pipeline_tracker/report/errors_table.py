"""Errors against a truth: what `evaluate` measured, in the report."""

from __future__ import annotations

import math
from xml.etree import ElementTree as ET

from pipeline_tracker.evaluation.schema import Evaluation, GroupFigures, MeanMax
from pipeline_tracker.report.html import add, add_table
from pipeline_tracker.report.reasons import count

_ERRORS = {
    "heading_misalignment": ("heading", "°", math.degrees(1.0)),
    "pitch_misalignment": ("pitch", "°", math.degrees(1.0)),
    "min_distance": ("distance", "cm", 100.0),
    "lateral_offset": ("lateral offset", "cm", 100.0),
    "approach_speed": ("approach speed", "cm/s", 100.0),
}


def add_errors(main: ET.Element, evaluation: Evaluation) -> None:
    """Add the section: a sentence, error curves, and two tables."""
    section = add(main, "section", aria_labelledby="errors")
    add(section, "h2", "Errors against the truth", id="errors")
    for sentence in truth_in_words(evaluation):
        add(section, "p", sentence)
    add(
        section,
        "p",
        "A frame's errors: both ends of the published piece of the axis from the true axis (sum), "
        "distance and heading (estimate less truth; bands: 95 % as the estimates have it).",
        class_="hint",
    )
    add(section, "div", id="errorlines", class_="plot", role="img",
        aria_label="Errors over time")  # fmt: skip
    heads = ["group", "frames", "horizontal, cm", "vertical, cm", "total, cm", "in 95 % region"]
    groups = [_group(name, figures) for name, figures in evaluation.groups.items()]
    add(section, "h3", "Distance of the segment's ends from the true axis, sum of both")
    add_table(section, "Divergence", heads, groups)
    signed = evaluation.groups["all"].errors
    rows = []
    for name, (title, unit, factor) in _ERRORS.items():
        if name in signed and signed[name].frames:
            error = signed[name]
            values = [_number(error.mean, factor), _number(error.rms, factor),
                      _number(error.extreme, factor), _share(error.in_95)]  # fmt: skip
            rows.append([f"{title}, {unit}", str(error.frames), *values])
    if rows:
        add(section, "h3", "Estimate less truth, valid frames")
        heads = ["", "frames", "mean", "rms", "extreme", "within 1.96 sigma"]
        add_table(section, "Errors", heads, rows)


def truth_in_words(evaluation: Evaluation) -> list[str]:
    """Return how the replay did against the truth."""
    counts, total = evaluation.counts, evaluation.groups["all"].divergence.total
    said = []
    if total.mean is not None and total.max is not None:
        said.append(
            f"The segment's ends are off the true axis by {100.0 * total.mean:.2f} cm in the mean "
            f"and {100.0 * total.max:.2f} cm at most (sum of both)."
        )
    if counts.detectable:
        said.append(
            f"Of {count(counts.detectable, 'frame')} in which the pipe could be seen, "
            f"{counts.detectable_valid} were valid."
        )
    if counts.false_valid:
        said.append(f"{count(counts.false_valid, 'valid frame')} had it wrong (crossed below).")
    elif counts.valid:
        said.append("No valid frame had it wrong.")
    return said


def _group(name: str, figures: GroupFigures) -> list[str]:
    spread = figures.divergence
    parts = [_mean_max(part) for part in (spread.horizontal, spread.vertical, spread.total)]
    title = {"all": "all valid", "technique_4": "technique 4, joint fit"}.get(name, name)
    title = title.replace("_", " ")
    return [title, str(figures.frames), *parts, _share(figures.coverage_95.share)]


def _mean_max(spread: MeanMax) -> str:
    if spread.mean is None or spread.max is None:
        return ""
    return f"{100.0 * spread.mean:.2f} (max {100.0 * spread.max:.2f})"


def _number(value: float | None, factor: float) -> str:
    return "" if value is None else f"{round(value * factor, 2) + 0.0:.2f}"


def _share(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.0f} %"
