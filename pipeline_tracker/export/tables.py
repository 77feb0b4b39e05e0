"""The tables that are exported: centreline, stretches, events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.report.record import Record, number, seconds_of
from pipeline_tracker.report.stretches import Course, Stretch, course_of

Array = NDArray[np.float64]
Row = dict[str, Any]

# Where a row of a table is, in odom and, where odom's place on the earth is given, there.
PLACE = ("x", "y", "z")
GEODETIC = ("latitude", "longitude", "height")
COLUMNS = {
    "centreline": (
        "stamp_ns",
        "frame",
        "run",
        "stretch",
        "chainage",
        "vehicle_chainage",
        *PLACE,
        "sigma_left",
        "sigma_up",
        *GEODETIC,
    ),
    "stretches": (
        "stretch",
        "course",
        "lie",
        "first_frame",
        "last_frame",
        "start_ns",
        "end_ns",
        "start_s",
        "end_s",
        "vehicle_chainage_from",
        "vehicle_chainage_to",
        "length",
        "bed_left",
        "bed_right",
        "clearance",
        "reasons",
    ),
    "events": (
        "stamp_ns",
        "frame",
        "seconds",
        "event",
        "reason",
        "run",
        "vehicle_chainage",
        *PLACE,
        *GEODETIC,
    ),
}
POSE_JUMP = "pose_jump"


@dataclass(frozen=True)
class Tables:
    """What is exported; a cell that is not known is None.

    Attributes:
        centreline: the axis in odom, a point for each valid frame: middle of its segment, m, with
            its own chainage, and that of the vehicle as estimates.csv has it.
        stretches: where the pipe was followed, how it lies, and where it was lost.
        events: found, lost, pose_jump, reset; placed where the vehicle was, in odom, m.
    """

    centreline: list[Row]
    stretches: list[Row]
    events: list[Row]


def make_tables(record: Record) -> Tables:
    """Return the tables of a replay; frames and stretches are counted from 1."""
    runs = _runs(record)
    return Tables(
        list(_centreline(record, runs)),
        [_stretch(record, n, s) for n, s in enumerate(record.stretches, start=1)],
        list(_events(record, runs)),
    )


def _runs(record: Record) -> list[int | None]:
    """Return for each row how often the tracker had forgotten its past; None: not processed."""
    states = [record.states.get(int(row["stamp_ns"])) for row in record.rows]
    return [None if state is None else state.reset_counter for state in states]


def _centreline(record: Record, runs: list[int | None]) -> Iterator[Row]:
    for number_of_stretch, stretch in enumerate(record.stretches, start=1):
        if stretch.course is not Course.FOLLOWED:
            continue
        for index in range(stretch.first, stretch.last + 1):
            row = record.rows[index]
            stamp = int(row["stamp_ns"])
            placed = record.placed.get(stamp)
            if placed is None:
                continue
            yield {
                "stamp_ns": stamp,
                "frame": index + 1,
                "run": runs[index],
                "stretch": number_of_stretch,
                "chainage": placed.chainage,
                "vehicle_chainage": number(row, "chainage"),
                **_place(placed.middle),
                "sigma_left": placed.sigma_left,
                "sigma_up": placed.sigma_up,
            }


def _stretch(record: Record, index: int, stretch: Stretch) -> Row:
    return {
        "stretch": index,
        "course": stretch.course.value,
        "lie": stretch.lie.value if stretch.course is Course.FOLLOWED else None,
        "first_frame": stretch.first + 1,
        "last_frame": stretch.last + 1,
        "start_ns": stretch.start_ns,
        "end_ns": stretch.end_ns,
        "start_s": seconds_of(record, stretch.start_ns),
        "end_s": seconds_of(record, stretch.end_ns),
        "vehicle_chainage_from": stretch.chainage_from,
        "vehicle_chainage_to": stretch.chainage_to,
        "length": stretch.length,
        "bed_left": stretch.bed_left,
        "bed_right": stretch.bed_right,
        "clearance": stretch.clearance,
        "reasons": "; ".join(f"{reason} ({count})" for reason, count in stretch.reasons) or None,
    }


def _events(record: Record, runs: list[int | None]) -> Iterator[Row]:
    followed, run = False, None
    for index, row in enumerate(record.rows):
        reason = row["reason"]
        names = []
        if POSE_JUMP in reason.split(", "):
            names.append("pose_jump")
        if None not in (run, runs[index]) and runs[index] != run:
            names.append("reset")
        run = runs[index] if runs[index] is not None else run
        follows = course_of(row["state"], valid=row["valid"] == "1") is Course.FOLLOWED
        if follows != followed:
            names.append("found" if follows else "lost")
        followed = follows
        for name in names:
            yield _event(record, index, name, run)


def _event(record: Record, index: int, name: str, run: int | None) -> Row:
    row = record.rows[index]
    stamp = int(row["stamp_ns"])
    pose = record.poses.get(stamp)
    return {
        "stamp_ns": stamp,
        "frame": index + 1,
        "seconds": (stamp - int(record.rows[0]["stamp_ns"])) / SECOND_NS,
        "event": name,
        "reason": row["reason"] or None,
        "run": run,
        "vehicle_chainage": number(row, "chainage"),
        **({} if pose is None else _place(pose.translation)),
    }


def _place(point: Array) -> Row:
    return dict(zip(PLACE, map(float, point), strict=True))
