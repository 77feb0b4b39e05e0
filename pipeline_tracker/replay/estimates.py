"""estimates.csv: one row for each left image."""

from __future__ import annotations

import csv
from array import array
from io import StringIO
from pathlib import Path
from types import TracebackType

import numpy as np
from typing_extensions import Self

from pipeline_tracker.types import PipeSegment, RelativeState, State, TrackingStatus

COLUMNS = (
    "stamp_ns",
    "state",
    "valid",
    "reason",
    "mode",
    "technique",
    "support",
    "start_x",
    "start_y",
    "start_z",
    "end_x",
    "end_y",
    "end_z",
    "heading_misalignment",
    "pitch_misalignment",
    "min_distance",
    "approach_speed",
    "lateral_offset",
    "side",
    "upper_x",
    "upper_y",
    "upper_z",
    "chainage",
    "bed_left",
    "bed_right",
    "processing_ms",
)


def lost_row(stamp_ns: int, reason: str) -> dict[str, str]:
    """Return the row of a left image that could not be processed."""
    return {"stamp_ns": str(stamp_ns), "valid": "0", "reason": reason}


def estimate_row(
    status: TrackingStatus,
    segment: PipeSegment | None,
    state: RelativeState,
    *,
    has_pose: bool,
    processing_ms: float,
    bed: tuple[float | None, float | None] = (None, None),
) -> dict[str, str]:
    """Return the row of a processed frame; what is undefined is left out (an empty cell).

    Args:
        status, segment, state: what the pipeline said; points in base_link, m, angles in rad.
        has_pose: whether the frame had a pose; without one there is no chainage.
        processing_ms: images in to relative state out.
        bed: height of the axis above the bed beside the pipe, left and right along the segment, m;
            None where not known.
    """
    row = {
        "stamp_ns": str(status.stamp_ns),
        "state": status.state.name.lower(),
        "valid": str(int(state.valid)),
        "reason": status.reason,
        "side": state.side.name.lower(),
        "processing_ms": f"{processing_ms:.3f}",
    }
    if segment is None or status.state == State.SEARCHING:
        return row
    row["mode"] = segment.mode.name.lower()
    row["technique"] = str(int(segment.technique))
    numbers: dict[str, float] = {
        "support": segment.support,
        "min_distance": state.min_distance,
        "lateral_offset": state.lateral_offset,
    }
    for name, point in (("start", segment.start), ("end", segment.end)):
        numbers.update(zip((f"{name}_x", f"{name}_y", f"{name}_z"), map(float, point), strict=True))
    # A variance of -1 beside a zero says: not known.
    if state.heading_variance >= 0.0 or state.heading_misalignment:
        numbers["heading_misalignment"] = state.heading_misalignment
    if state.pitch_variance >= 0.0 or state.pitch_misalignment:
        numbers["pitch_misalignment"] = state.pitch_misalignment
    if state.speed_variance >= 0.0:
        numbers["approach_speed"] = state.approach_speed
    if has_pose:
        numbers["chainage"] = state.chainage
    if np.any(state.upper_point):
        x, y, z = (float(v) for v in state.upper_point)
        numbers.update(upper_x=x, upper_y=y, upper_z=z)
    beside = zip(("bed_left", "bed_right"), bed, strict=True)
    numbers.update({name: height for name, height in beside if height is not None})
    row.update({name: _number(value) for name, value in numbers.items()})
    return row


class EstimatesFile:
    """Writes estimates.csv row by row; a context manager.

    Rows are on disk as soon as they are written. Images that came too late to be processed in
    their turn are put in their place when the file is closed.
    """

    def __init__(self, path: Path) -> None:
        """Remember the path; ``__enter__`` opens it."""
        self._path = path
        self._keys = array("q")
        self._in_order = True

    def __enter__(self) -> Self:
        """Create the file with its header.

        Raises:
            OSError: it cannot be written.
        """
        self._file = self._path.open("w", newline="", encoding="utf-8", buffering=1)
        self._file.write(_line(dict(zip(COLUMNS, COLUMNS, strict=True))))
        return self

    def write(self, epoch: int, row: dict[str, str]) -> None:
        """Append a row; ``epoch`` counts how often the clocks were set back.

        Raises:
            OSError: it cannot be written.
        """
        stamp = int(row["stamp_ns"])
        if self._keys and (epoch, stamp) < (self._keys[-2], self._keys[-1]):
            self._in_order = False
        self._keys.extend((epoch, stamp))
        self._file.write(_line(row))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file, its rows in time order."""
        self._file.close()
        if not self._in_order:
            self._sort()

    def _sort(self) -> None:
        keys = list(zip(self._keys[::2], self._keys[1::2], strict=True))
        order = sorted(range(len(keys)), key=keys.__getitem__)
        beside = self._path.with_suffix(".csv.tmp")
        with self._path.open("rb") as source, beside.open("wb") as target:
            target.write(source.readline())
            places = []
            for _ in keys:
                places.append(source.tell())
                source.readline()
            for index in order:
                source.seek(places[index])
                target.write(source.readline())
        beside.replace(self._path)


def _line(row: dict[str, str]) -> str:
    text = StringIO()
    # A line break inside a cell would break the rows of simple readers.
    cells = [" ".join(row.get(name, "").split()) for name in COLUMNS]
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _number(value: float) -> str:
    text = f"{value:.9f}"
    return text[1:] if float(text) == 0.0 and text.startswith("-") else text
