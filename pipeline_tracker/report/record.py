"""What a replay left in its directory, row by row, for the report."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import BagError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.messages import (
    pose_from_message,
    relative_state_from_message,
    segment_from_message,
    stamp_ns,
)
from pipeline_tracker.report.facts import RunFacts, read_facts
from pipeline_tracker.report.filmstrip import pictures
from pipeline_tracker.report.stretches import Stretch, find_stretches, frame_of_row
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.types import PipeSegment, RelativeState

Array = NDArray[np.float64]
Row = dict[str, str]

_NEEDED = ("stamp_ns", "state", "valid", "reason", "mode", "chainage")
_TOPICS = {
    "/pipeline/segment": segment_from_message,
    "/pipeline/relative_state": relative_state_from_message,
    "/vnm/pose": pose_from_message,
}


@dataclass(frozen=True)
class Placed:
    """The pipe of a frame, and the vehicle, in odom.

    Attributes:
        middle: of the segment, (3,), m.
        direction: along the pipe, (3,), unit.
        chainage: of the middle, m; None where the frame has none.
        sigma_left, sigma_up: standard deviations of the axis there, m; None where not known.
    """

    middle: Array
    direction: Array
    chainage: float | None
    sigma_left: float | None
    sigma_up: float | None


@dataclass
class Record:
    """A replay's directory.

    Attributes:
        directory: where it is.
        settings: its settings.
        settings_text: settings.yaml as it is.
        rows: the rows of estimates.csv.
        facts: what the replay said of itself; None where it was cut off.
        pictures: by stamp, ns.
        states, poses: relative state and odom <- base_link by stamp.
        placed: the pipe in odom by stamp.
        stretches: see ``find_stretches``.
    """

    directory: Path
    settings: Settings
    settings_text: str
    rows: list[Row]
    facts: RunFacts | None
    pictures: dict[int, Path]
    states: dict[int, RelativeState] = field(default_factory=dict)
    poses: dict[int, Pose] = field(default_factory=dict)
    placed: dict[int, Placed] = field(default_factory=dict)
    stretches: list[Stretch] = field(default_factory=list)


def read_record(directory: Path) -> Record:
    """Read what a replay left.

    Raises:
        BagError: it is not a replay's output, or a file in it is damaged.
        SettingsError: its settings are.
    """
    table, config = directory / "estimates.csv", directory / "settings.yaml"
    for file in (table, config):
        if not file.is_file():
            raise BagError(
                f"{directory}: no {file.name} in it; expected the output directory of "
                "`pipeline-tracker replay`"
            )
    settings = load_settings(config)
    record = Record(
        directory=directory,
        settings=settings,
        settings_text=config.read_text(encoding="utf-8"),
        rows=_read_table(table),
        facts=read_facts(directory),
        pictures=pictures(directory),
    )
    try:
        frames = [frame_of_row(row) for row in record.rows]
    except (KeyError, ValueError) as error:
        raise BagError(f"{table}: {error}; the table is damaged, replay again") from None
    record.stretches = find_stretches(frames, settings.radius)
    _read_result(directory / "result", record)
    return record


def number(row: Row, name: str) -> float | None:
    """Return a cell as a number; None where it is empty or not a finite number."""
    try:
        value = float(row.get(name) or "nan")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def seconds_of(record: Record, stamp_ns: int) -> float:
    """Return the time since the first frame, s."""
    return (stamp_ns - int(record.rows[0]["stamp_ns"])) / SECOND_NS


def _read_table(path: Path) -> list[Row]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in _NEEDED if name not in (reader.fieldnames or ())]
            if missing:
                raise BagError(
                    f"{path}: it has no column {missing[0]}; expected the table of a replay"
                )
            # A row that was cut off lacks cells.
            return [row for row in reader if None not in row.values()]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BagError(f"{path}: cannot be read ({error})") from None


def _read_result(path: Path, record: Record) -> None:
    """Read states, poses and segments, where the result bag is there."""
    segments: dict[int, PipeSegment] = {}
    # Where no frame was processed the bag is empty, and an empty bag is refused.
    if not path.exists() or not any(row["state"] for row in record.rows):
        return
    try:
        with BagReader(path) as bag:
            wanted = [topic for topic in _TOPICS if topic in bag.topics]
            for item in bag.records(wanted):
                message = item.unpack()
                read: Any = _TOPICS[item.topic](message)
                stamp = stamp_ns(message.header)
                if isinstance(read, RelativeState):
                    record.states[stamp] = read
                elif isinstance(read, PipeSegment):
                    segments[stamp] = read
                else:
                    record.poses[stamp] = read[1]
    except ValueError as error:
        raise BagError(f"{path}: {error}; replay again") from None
    _place(record, segments)


def _place(record: Record, segments: dict[int, PipeSegment]) -> None:
    """Place the segments in odom, in the order of the table."""
    ahead: Array | None = None
    for row in record.rows:
        stamp = int(row["stamp_ns"])
        segment, pose = segments.get(stamp), record.poses.get(stamp)
        if segment is None or pose is None or not segment.found or row["state"] == "searching":
            continue
        start, end = pose.apply(segment.start), pose.apply(segment.end)
        length = float(np.linalg.norm(end - start))
        if not length > 0.0:
            continue
        direction = (end - start) / length
        chainage = number(row, "chainage")
        middle = (start + end) / 2.0
        if chainage is not None:
            # The chainage keeps its sense when the vehicle turns round.
            if ahead is not None and chainage != 0.0 and float(ahead @ direction) < 0.0:
                ahead = -direction
            else:
                ahead = direction
            chainage += float((middle - pose.translation) @ ahead)
        variances = np.diag(segment.covariance)[:2]
        known = bool(np.isfinite(variances).all() and (variances > 0.0).all())
        left, up = np.sqrt(variances) if known else (None, None)
        record.placed[stamp] = Placed(
            middle,
            direction,
            chainage,
            None if left is None else float(left),
            None if up is None else float(up),
        )
