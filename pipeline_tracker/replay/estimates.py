"""estimates.csv: one row for each left image."""

from __future__ import annotations

import csv
import heapq
import os
from array import array
from io import StringIO
from pathlib import Path
from types import TracebackType

import numpy as np
from typing_extensions import Self

from pipeline_tracker.errors import BagError
from pipeline_tracker.replay.input import JUMP_NS
from pipeline_tracker.types import PipeSegment, RelativeState, State, TrackingStatus

# Unit and meaning of each column.
COLUMNS = {
    "stamp_ns": ("ns", "Stamp of the left image"),
    "state": ("", "searching, tracking or coasting; empty: the image was lost"),
    "valid": (
        "",
        "1: the pipe was seen in this very image and the answer is trusted; steer by nothing else",
    ),
    "reason": ("", "Why it is no better"),
    "mode": ("", "recognition or tracking"),
    "technique": ("", "0 tracking; 1, 2, 3 of the paper; 4 the joint fit"),
    "support": ("", "Share of the expected evidence that was found, 0 to 1"),
    "start_x": ("m", "End of the axis segment that lies behind, in base_link"),
    "start_y": ("m", "End of the axis segment that lies behind, in base_link"),
    "start_z": ("m", "End of the axis segment that lies behind, in base_link"),
    "end_x": ("m", "End of the axis segment that lies ahead, in base_link"),
    "end_y": ("m", "End of the axis segment that lies ahead, in base_link"),
    "end_z": ("m", "End of the axis segment that lies ahead, in base_link"),
    "heading_misalignment": (
        "rad",
        "From the vehicle's motion to the pipe; positive: the pipe leads to port",
    ),
    "pitch_misalignment": ("rad", "Positive: the pipe climbs above the vehicle's path"),
    "min_distance": ("m", "From the left camera to the pipe's surface"),
    "approach_speed": ("m/s", "Positive: coming nearer"),
    "lateral_offset": ("m", "Positive: the vehicle is to port of the pipe"),
    "side": ("", "along, left_of_pipe, right_of_pipe or not_in_view"),
    "upper_x": ("m", "Q, the upper point of the pipe's surface, in base_link"),
    "upper_y": ("m", "Q, the upper point of the pipe's surface, in base_link"),
    "upper_z": ("m", "Q, the upper point of the pipe's surface, in base_link"),
    "chainage": ("m", "Way along the pipe since it was first recognised"),
    "processing_ms": ("ms", "Images in to relative state out"),
    "bed_left": ("m", "Height of the axis above the bed to the left of it, along travel"),
    "bed_right": ("m", "The same to the right"),
}


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


def _line(row: dict[str, str]) -> str:
    text = StringIO()
    # A line break inside a cell would break the rows of simple readers.
    cells = [" ".join(row.get(name, "").split()) for name in COLUMNS]
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


HEADER = _line(dict(zip(COLUMNS, COLUMNS, strict=True))).encode()


class EstimatesFile:
    """Writes estimates.csv row by row, in time order; a context manager.

    A row is on its way to the disk once no earlier one can come: an image that comes late is less
    than a second of stamps behind. Whatever ends the replay, the file holds whole rows.
    """

    def __init__(self, path: Path, kept: KeptRows | None = None) -> None:
        """Remember the path; ``__enter__`` opens it.

        Args:
            path: the file.
            kept: rows of a replay that was broken off: they stay where the same ones are written
                again, and what follows them is appended.
        """
        self._path = path
        self._kept = kept
        self._held: list[tuple[int, int, int, bytes]] = []
        self._newest = (0, 0)
        self._count = 0
        self._size = 0
        self._broken = False

    def __enter__(self) -> Self:
        """Open the file, with its header.

        Raises:
            OSError: it cannot be written.
        """
        mode = "wb" if self._kept is None else "r+b"
        self._file = self._path.open(mode, buffering=0)
        self._put(HEADER)
        return self

    def write(self, epoch: int, row: dict[str, str]) -> None:
        """Take in a row; ``epoch`` counts how often the clocks were set back.

        Raises:
            OSError: it cannot be written.
            BagError: it is another than the one that was kept.
        """
        stamp = int(row["stamp_ns"])
        heapq.heappush(self._held, (epoch, stamp, self._count, _line(row).encode()))
        self._count += 1
        self._newest = max(self._newest, (epoch, stamp))
        while self._held[0][:2] < (self._newest[0], self._newest[1] - JUMP_NS):
            self._put(heapq.heappop(self._held)[-1])

    def save(self) -> None:
        """See to it that what is written is still there when the power fails.

        Raises:
            OSError: it cannot be written.
        """
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write the rows that are held: no other will come.

        Raises:
            OSError: they cannot be written.
            BagError: they are others than those that were kept.
        """
        while self._held:
            self._put(heapq.heappop(self._held)[-1])
        if self._kept is not None and self._kept.left:
            raise self._kept.mismatch(self._path)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file; rows that are held are written, but not over those that were kept."""
        try:
            if self._kept is None and not self._broken:
                self.finish()
        finally:
            self._file.close()

    def _put(self, line: bytes) -> None:
        if self._kept is not None:
            if self._kept.has(line):
                self._size = self._kept.place
                return
            if self._kept.settled:
                raise self._kept.mismatch(self._path)
            self._kept = None
            self._file.truncate(self._size)
            self._file.seek(self._size)
        try:
            rest = memoryview(line)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            # Half a row is worse than none.
            self._broken = True
            self._file.truncate(self._size)
            raise
        self._size += len(line)


class KeptRows:
    """The rows of a replay that was broken off, one after another.

    The last second of them may have been written by an interrupt, before a late image came: they
    are taken where they are the same, and written anew where they are not.

    Attributes:
        settled: rows that must come again as they are, those read before left out.
        place: where the next row begins, bytes.
    """

    def __init__(self, path: Path) -> None:
        """Look at the file; what is no whole row, and all behind it, counts for nothing.

        Raises:
            OSError: it cannot be read.
        """
        self._file = path.open("rb")
        stamps = array("q")
        header = self._file.readline() == HEADER
        while header:
            stamp = _stamp(self._file.readline())
            if stamp is None:
                break
            stamps.append(stamp)
        self._left = len(stamps) + header
        self.settled = len(stamps)
        while self.settled and stamps[self.settled - 1] >= stamps[-1] - JUMP_NS:
            self.settled -= 1
        self.rows = self.settled
        self.place = 0
        self._file.seek(0)

    @property
    def left(self) -> int:
        """Number of rows that have not come again."""
        return self._left

    def has(self, line: bytes) -> bool:
        """Return whether the next row is this one, whatever time it took; if so, go on."""
        if not self._left:
            self._file.close()
            return False
        kept = self._file.readline()
        if _without_time(kept) != _without_time(line):
            return False
        self._left -= 1
        self.settled -= line != HEADER and self.settled > 0
        self.place += len(kept)
        return True

    def mismatch(self, path: Path) -> BagError:
        """Return the error that the replay does not come out as before."""
        return BagError(
            f"{path}: the row at byte {self.place} does not come out as it did before; bag, "
            "program or libraries have changed: begin again with --force"
        )


def _stamp(line: bytes) -> int | None:
    """Return the stamp of a whole row; None where it is not one."""
    cells = line.split(b",")
    if not line.endswith(b"\n") or len(cells) < len(COLUMNS) or not cells[0].isdigit():
        return None
    return int(cells[0])


def _without_time(line: bytes) -> bytes:
    """Return a row without processing_ms: counted from its end, where no cell holds a comma."""
    behind = len(COLUMNS) - list(COLUMNS).index("processing_ms")
    before, _, *after = line.rsplit(b",", behind)
    return b",".join((before, *after))


def _number(value: float) -> str:
    text = f"{value:.9f}"
    return text[1:] if float(text) == 0.0 and text.startswith("-") else text
