"""The numbers that the page draws: columns with one entry for each frame, as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from typing import Any

from pipeline_tracker.evaluation.schema import Evaluation, FrameFigures
from pipeline_tracker.report.reasons import in_words
from pipeline_tracker.report.record import Placed, Record, Row, number, seconds_of
from pipeline_tracker.report.stretches import Course
from pipeline_tracker.types import RelativeState

_STATES = ("", "searching", "coasting", "tracking")
# name: column of estimates.csv, factor to the unit shown, decimals.
_FROM_TABLE = {
    "heading": ("heading_misalignment", math.degrees(1.0), 2),
    "pitch": ("pitch_misalignment", math.degrees(1.0), 2),
    "distance": ("min_distance", 1.0, 3),
    "speed": ("approach_speed", 1.0, 3),
    "lateral": ("lateral_offset", 1.0, 3),
    "chainage": ("chainage", 1.0, 3),
    "bedLeft": ("bed_left", 1.0, 3),
    "bedRight": ("bed_right", 1.0, 3),
}

Cell = float | int | str | None


def page_data(record: Record, evaluation: Evaluation | None) -> str:
    """Return what the page draws, as JSON that may stand inside a script element.

    Args:
        record: the replay.
        evaluation: its errors; None without a truth.
    """
    rows = record.rows
    stamps = [int(row["stamp_ns"]) for row in rows]
    reasons = {reason: k for k, reason in enumerate(dict.fromkeys(row["reason"] for row in rows))}
    place = {stamp: k for k, stamp in enumerate(stamps)}
    columns: dict[str, list[Cell]] = {
        "t": [_rounded(seconds_of(record, stamp), 3) for stamp in stamps],
        # Nanoseconds do not fit the numbers of a browser.
        "stamp": [str(stamp) for stamp in stamps],
        "state": [_STATES.index(s) if (s := row["state"]) in _STATES else 0 for row in rows],
        "valid": [int(row["valid"] == "1") for row in rows],
        "reason": [reasons[row["reason"]] for row in rows],
        "mode": [row["mode"] for row in rows],
        "side": [row.get("side", "").replace("_", " ") for row in rows],
        **{name: _of_table(rows, *what) for name, what in _FROM_TABLE.items()},
        **_of_states(record, stamps),
        **_of_places(record, stamps),
    }
    data = {
        "columns": columns,
        "reasons": [in_words(reason) if reason else "" for reason in reasons],
        "lost": [
            [stretch.first, stretch.last, int(stretch.course is Course.COASTING)]
            for stretch in record.stretches
            if stretch.course is not Course.FOLLOWED
        ],
        "pictures": sorted(place[stamp] for stamp in record.pictures if stamp in place),
        "radius": record.settings.radius,
        "errors": None if evaluation is None else _of_errors(evaluation.per_frame),
    }
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    # A "</script>" inside a reason would end the element.
    return text.replace("<", "\\u003c")


def _rounded(value: float | None, decimals: int) -> Cell:
    if value is None or not math.isfinite(value):
        return None
    return round(value, decimals) + 0.0


def _of_table(rows: Iterable[Row], column: str, factor: float, decimals: int) -> list[Cell]:
    found = (number(row, column) for row in rows)
    return [None if value is None else _rounded(value * factor, decimals) for value in found]


def _of_states(record: Record, stamps: list[int]) -> dict[str, list[Cell]]:
    def sigma(name: str, factor: float, decimals: int) -> list[Cell]:
        def of(state: RelativeState) -> Cell:
            variance = getattr(state, name)
            return _rounded(factor * math.sqrt(variance), decimals) if variance >= 0.0 else None

        return [None if state is None else of(state) for state in states]

    states = [record.states.get(stamp) for stamp in stamps]
    return {
        "quality": [_rounded(state.quality, 3) if state else None for state in states],
        "sigmaHeading": sigma("heading_variance", math.degrees(1.0), 3),
        "sigmaPitch": sigma("pitch_variance", math.degrees(1.0), 3),
        "sigmaDistance": sigma("distance_variance", 1.0, 4),
        "sigmaSpeed": sigma("speed_variance", 1.0, 4),
    }


def _of_places(record: Record, stamps: list[int]) -> dict[str, list[Cell]]:
    places = [record.placed.get(stamp) for stamp in stamps]
    poses = [record.poses.get(stamp) for stamp in stamps]

    def pipe(read: Callable[[Placed], float | None], decimals: int = 3) -> list[Cell]:
        return [None if place is None else _rounded(read(place), decimals) for place in places]

    columns = {
        "pipeX": pipe(lambda p: float(p.middle[0])),
        "pipeY": pipe(lambda p: float(p.middle[1])),
        "pipeZ": pipe(lambda p: float(p.middle[2])),
        "pipeChainage": pipe(lambda p: p.chainage),
        "aheadX": pipe(lambda p: float(p.direction[0])),
        "aheadY": pipe(lambda p: float(p.direction[1])),
        "sigmaLeft": pipe(lambda p: p.sigma_left, 4),
        "sigmaUp": pipe(lambda p: p.sigma_up, 4),
    }
    for k, name in enumerate(("ownX", "ownY", "ownZ")):
        columns[name] = [
            None if pose is None else _rounded(float(pose.translation[k]), 3) for pose in poses
        ]
    return columns


def _of_errors(frames: Iterable[FrameFigures]) -> dict[str, list[Any]]:
    """Return errors against the truth: cm and degrees, one entry for each row."""
    frames = list(frames)

    def cm(value: float | None) -> Cell:
        return None if value is None else _rounded(100.0 * value, 3)

    return {
        "horizontal": [cm(frame.horizontal) for frame in frames],
        "vertical": [cm(frame.vertical) for frame in frames],
        "distance": [cm(frame.errors.get("min_distance")) for frame in frames],
        "sigmaDistance": [cm(frame.error_sigmas.get("min_distance")) for frame in frames],
        "heading": _degrees(frame.errors.get("heading_misalignment") for frame in frames),
        "sigmaHeading": _degrees(
            frame.error_sigmas.get("heading_misalignment") for frame in frames
        ),
        "wrong": [k for k, frame in enumerate(frames) if frame.false_reasons],
    }


def _degrees(values: Iterable[float | None]) -> list[Cell]:
    return [None if value is None else _rounded(math.degrees(value), 4) for value in values]
