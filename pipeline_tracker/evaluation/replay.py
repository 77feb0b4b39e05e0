"""What a replay left behind: estimates.csv, settings.yaml and the bag of its results."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import CalibrationError, EvaluationError, MessageError
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    pose_from_message,
    relative_state_from_message,
    segment_from_message,
    stamp_ns,
    vectorized_from_message,
)
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.types import PipeSegment, RelativeState

Array = NDArray[np.float64]

# The VNM's pose of each frame, in the result bag.
POSE = "vnm/pose"
_POINTS = [f"{end}_{axis}" for end in ("start", "end") for axis in "xyz"]
NUMBERS = (
    "heading_misalignment",
    "pitch_misalignment",
    "min_distance",
    "approach_speed",
    "lateral_offset",
)
_COLUMNS = ("stamp_ns", "state", "valid", "reason", "mode", "technique", *_POINTS, *NUMBERS)


@dataclass(frozen=True)
class Estimate:
    """A row of estimates.csv.

    Attributes:
        stamp_ns: stamp of the left image, ns.
        state, mode: names in lower case; mode empty without a segment.
        valid: whether an autopilot may use it.
        has_pose: whether the vehicle's pose was known.
        technique: 0 tracking, 1 to 4; None without a segment.
        start, end: ends of the segment in base_link, (3,), m; None without a segment.
        numbers: the columns of ``NUMBERS`` that are not empty.
        reason: as the table has it.
    """

    stamp_ns: int
    state: str
    valid: bool
    has_pose: bool
    mode: str
    technique: int | None
    start: Array | None
    end: Array | None
    numbers: dict[str, float]
    reason: str = ""


@dataclass
class Replay:
    """A replay.

    Attributes:
        directory: where it is.
        settings: its settings.
        estimates: its rows, in time order.
        segments: the segment by stamp; empty where the result bag is missing.
        states: the relative state by stamp, likewise.
        thumbnails: left thumbnail by stamp, of a few frames, as the replay saw them.
        poses: odom <- base_link by stamp, as the replay took them; empty where it did not say.
        rig: the cameras; None where the result bag is missing.
    """

    directory: Path
    settings: Settings
    estimates: list[Estimate]
    segments: dict[int, PipeSegment] = field(default_factory=dict)
    states: dict[int, RelativeState] = field(default_factory=dict)
    thumbnails: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)
    rig: StereoRig | None = None


def read_replay(directory: Path, thumbnails: int = 5) -> Replay:
    """Read a replay.

    Args:
        directory: the output directory of a replay.
        thumbnails: of how many frames, evenly spread, to keep the thumbnail.

    Raises:
        EvaluationError: it is not a replay's output, or its table is damaged.
        BagError: its result bag is damaged.
        SettingsError: its settings are.
    """
    table, config = directory / "estimates.csv", directory / "settings.yaml"
    for file in (table, config):
        if not file.is_file():
            raise EvaluationError(
                f"{directory}: no {file.name} in it; expected the output directory of "
                "`pipeline-tracker replay`"
            )
    estimates = _read_table(table)
    if not estimates:
        raise EvaluationError(f"{table}: it has no rows, there is nothing to evaluate")
    every = max(1, len(estimates) // thumbnails)
    wanted = {e.stamp_ns for e in estimates[every // 2 :: every][:thumbnails]}
    replay = Replay(directory, load_settings(config), estimates)
    if (directory / "result").exists():
        _read_result(directory / "result", replay, wanted)
    return replay


def _read_table(path: Path) -> list[Estimate]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [c for c in _COLUMNS if c not in (reader.fieldnames or ())]
            if missing:
                raise EvaluationError(
                    f"{path}: it has no column {missing[0]}; expected the table of a replay"
                )
            return [_estimate(path, reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise EvaluationError(f"{path}: cannot be read ({error})") from None


def _estimate(path: Path, line: int, row: dict[str, str]) -> Estimate:
    try:
        estimate = Estimate(
            stamp_ns=int(row["stamp_ns"]),
            state=row["state"],
            valid=bool(int(row["valid"])),
            has_pose="no_pose" not in row["reason"],
            mode=row["mode"],
            technique=int(row["technique"]) if row["technique"] else None,
            start=_point(row, "start"),
            end=_point(row, "end"),
            numbers={name: _number(row[name]) for name in NUMBERS if row[name]},
            reason=row["reason"],
        )
    except (ValueError, TypeError) as error:
        raise EvaluationError(
            f"{path}, line {line}: {error}; the table is damaged, replay again"
        ) from None
    start, end = estimate.start, estimate.end
    if estimate.valid and (start is None or end is None):
        raise EvaluationError(f"{path}, line {line}: a valid row without a segment; replay again")
    if start is not None and end is not None and np.array_equal(start, end):
        raise EvaluationError(f"{path}, line {line}: a segment without length; replay again")
    return estimate


def _point(row: dict[str, str], name: str) -> Array | None:
    cells = [row[f"{name}_{axis}"] for axis in "xyz"]
    return np.array([_number(cell) for cell in cells]) if all(cells) else None


def _number(cell: str) -> float:
    value = float(cell)
    if not np.isfinite(value):
        raise ValueError(f"{cell} is not a finite number")
    return value


def _read_result(path: Path, replay: Replay, thumbnails: set[int]) -> None:
    """Fill in what the table does not hold."""
    with BagReader(path) as bag:
        names = {
            name: kind
            for name in bag.topics
            for kind in ("pipeline/segment", "pipeline/relative_state", "pipeline/vectorized", POSE)
            if name.endswith(kind)
        }
        for record in bag.records(names):
            kind = names[record.topic]
            if kind == "pipeline/vectorized" and not (
                replay.rig is None or record.stamp_guess() in thumbnails
            ):
                continue
            try:
                _take(replay, kind, record.unpack(), thumbnails)
            except (MessageError, CalibrationError) as error:
                raise EvaluationError(f"{path}: {record.topic}: {error}; replay again") from None


def _take(replay: Replay, kind: str, message: Any, thumbnails: set[int]) -> None:
    stamp = stamp_ns(message.header)
    if kind == "pipeline/segment":
        replay.segments[stamp] = segment_from_message(message)
    elif kind == "pipeline/relative_state":
        replay.states[stamp] = relative_state_from_message(message)
    elif kind == POSE:
        replay.poses[stamp] = pose_from_message(message)[1]
    else:
        vectorized = vectorized_from_message(message)
        replay.rig = vectorized.rig
        if stamp in thumbnails:
            replay.thumbnails[stamp] = vectorized.left_thumbnail
