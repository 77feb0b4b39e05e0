"""Stretches of the pipe: where it was followed, how it lies there, and where it was lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import groupby
from statistics import median

# The bed beside the pipe may be off the pipe's own level by so much of the diameter, by relief
# and by noise, before it is called a span or a burial.
_LEVEL = 0.15
# Heights are smoothed over so many frames, and a change that fewer show is none.
_SMOOTHED, _LEAST = 5, 3


class Course(Enum):
    """What became of a frame, or of a stretch of them."""

    FOLLOWED = "followed"
    COASTING = "coasting"
    SEARCHING = "searching"
    NOT_PROCESSED = "not processed"


class Lie(Enum):
    """How the pipe lies, as far as the bed on both sides of it tells."""

    FREE_SPAN = "free span"
    ON_BED = "on the bed"
    PARTLY_BURIED = "partly buried"
    MORE_THAN_HALF_BURIED = "more than half buried"
    NOT_KNOWN = "not known"


@dataclass(frozen=True)
class StretchFrame:
    """What a frame says about the stretch that it belongs to.

    Attributes:
        stamp_ns: stamp of the left image, ns.
        course: what became of the frame.
        reason: why; empty where all is well.
        chainage: m; None where not known. Exactly 0 after another value: it starts anew.
        bed_left, bed_right: height of the axis above the bed beside the pipe, seen along the
            segment, m; None where not known.
    """

    stamp_ns: int
    course: Course
    reason: str = ""
    chainage: float | None = None
    bed_left: float | None = None
    bed_right: float | None = None


@dataclass(frozen=True)
class Stretch:
    """Frames one after another of one course, and where they were followed, of one lie.

    Attributes:
        first, last: its frames, counted from 0.
        start_ns, end_ns: their stamps, ns.
        course: what became of it.
        reasons: reasons of its frames with how often, the most frequent first.
        chainage_from, chainage_to: m, in the order of travel; of a stretch where the pipe was not
            seen those of the frames around it; None where not known.
        lie: how the pipe lies.
        bed_left, bed_right: median height of the axis above the bed beside the pipe, m; None where
            not known.
        clearance: mean of these two less the radius, m: positive, the bed lies so far below the
            pipe; negative, so much of the pipe is below the bed; None where not known.
    """

    first: int
    last: int
    start_ns: int
    end_ns: int
    course: Course
    reasons: tuple[tuple[str, int], ...] = ()
    chainage_from: float | None = None
    chainage_to: float | None = None
    lie: Lie = Lie.NOT_KNOWN
    bed_left: float | None = None
    bed_right: float | None = None
    clearance: float | None = None

    @property
    def frames(self) -> int:
        """Number of its frames."""
        return self.last - self.first + 1

    @property
    def length(self) -> float | None:
        """Length along the pipe, m; None where not known."""
        if self.chainage_from is None or self.chainage_to is None:
            return None
        return abs(self.chainage_to - self.chainage_from)


def course_of(state: str, *, valid: bool) -> Course:
    """Return the course of a frame.

    Args:
        state: column ``state`` of estimates.csv; empty: the frame was never processed.
        valid: column ``valid``.
    """
    if valid:
        return Course.FOLLOWED
    if not state:
        return Course.NOT_PROCESSED
    return Course.COASTING if state == "coasting" else Course.SEARCHING


def frame_of_row(row: Mapping[str, str]) -> StretchFrame:
    """Read a row of estimates.csv.

    Raises:
        ValueError: a cell is not a number.
        KeyError: a column that every table has is missing.
    """

    def number(name: str) -> float | None:
        # Tables of earlier versions have no column of the bed.
        return float(row[name]) if row.get(name) else None

    return StretchFrame(
        stamp_ns=int(row["stamp_ns"]),
        course=course_of(row["state"], valid=row["valid"] == "1"),
        reason=row["reason"],
        chainage=number("chainage"),
        bed_left=number("bed_left"),
        bed_right=number("bed_right"),
    )


def find_stretches(frames: Sequence[StretchFrame], radius: float) -> list[Stretch]:
    """Divide a replay into stretches, in time order; every frame is in one of them.

    Args:
        frames: all rows of the table, in its order.
        radius: of the pipe, m.
    """
    parts: list[tuple[int, int, Lie]] = []
    for _, group in groupby(range(len(frames)), key=_runs(frames)):
        indices = list(group)
        first, last = indices[0], indices[-1]
        if frames[first].course is Course.FOLLOWED:
            parts += _by_lie(frames, first, last, radius)
        else:
            parts.append((first, last, Lie.NOT_KNOWN))
    stretches = [_stretch(frames, first, last, lie, radius) for first, last, lie in parts]
    return _with_chainages(stretches, frames)


def clearance(bed_left: float | None, bed_right: float | None, radius: float) -> float | None:
    """Return how far the bed lies below the pipe, m; negative: how much of the pipe is below it.

    Both sides must be known: their mean does not depend on a slope of the bed across the pipe.

    Args:
        bed_left, bed_right: height of the axis above the bed beside the pipe, m.
        radius: of the pipe, m.
    """
    if bed_left is None or bed_right is None:
        return None
    return (bed_left + bed_right) / 2.0 - radius


def lie_of(clear: float | None, radius: float) -> Lie:
    """Return how a pipe lies with such a ``clearance``, m."""
    if clear is None:
        return Lie.NOT_KNOWN
    if clear > 2.0 * radius * _LEVEL:
        return Lie.FREE_SPAN
    if clear < -radius:
        return Lie.MORE_THAN_HALF_BURIED
    return Lie.PARTLY_BURIED if clear < -2.0 * radius * _LEVEL else Lie.ON_BED


def _runs(frames: Sequence[StretchFrame]) -> Callable[[int], tuple[int, Course]]:
    """Return a key: the course of a frame, and how often the chainage started anew before it."""
    numbers, number, before = [], 0, None
    for frame in frames:
        if frame.chainage is not None:
            number += frame.chainage == 0.0 and before is not None and before != 0.0
            before = frame.chainage
        numbers.append(number)
    return lambda index: (numbers[index], frames[index].course)


def _by_lie(
    frames: Sequence[StretchFrame], first: int, last: int, radius: float
) -> list[tuple[int, int, Lie]]:
    """Divide frames that were followed by how the pipe lies there."""
    clear = [clearance(f.bed_left, f.bed_right, radius) for f in frames[first : last + 1]]
    half = _SMOOTHED // 2
    lies = [
        lie_of(_median(clear[max(0, k - half) : k + half + 1]), radius) for k in range(len(clear))
    ]
    parts: list[tuple[int, int, Lie]] = []
    for lie, group in groupby(range(len(lies)), key=lies.__getitem__):
        indices = list(group)
        start, end = first + indices[0], first + indices[-1]
        short = end - start + 1 < _LEAST
        if parts and (short or parts[-1][2] is lie):
            parts[-1] = (parts[-1][0], end, parts[-1][2])
        elif parts and parts[-1][1] - parts[-1][0] + 1 < _LEAST:
            # The first part was the short one.
            parts[-1] = (parts[-1][0], end, lie)
        else:
            parts.append((start, end, lie))
    return parts


def _stretch(
    frames: Sequence[StretchFrame], first: int, last: int, lie: Lie, radius: float
) -> Stretch:
    inside = frames[first : last + 1]
    reasons = Counter(frame.reason for frame in inside if frame.reason)
    left, right = _median(f.bed_left for f in inside), _median(f.bed_right for f in inside)
    return Stretch(
        first=first,
        last=last,
        start_ns=inside[0].stamp_ns,
        end_ns=inside[-1].stamp_ns,
        course=inside[0].course,
        reasons=tuple(reasons.most_common()),
        lie=lie,
        bed_left=left,
        bed_right=right,
        clearance=_median(clearance(f.bed_left, f.bed_right, radius) for f in inside),
    )


def _with_chainages(stretches: Sequence[Stretch], frames: Sequence[StretchFrame]) -> list[Stretch]:
    """Put in chainages: of a stretch where the pipe was not seen, those of the frames around."""
    done: list[Stretch] = []
    for number, stretch in enumerate(stretches):
        if stretch.course is Course.FOLLOWED:
            start, end = frames[stretch.first].chainage, frames[stretch.last].chainage
            follows = number > 0 and stretches[number - 1].course is Course.FOLLOWED
            if follows and start != 0.0:
                # Without a gap between two ways to lie.
                start = frames[stretch.first - 1].chainage
        else:
            start, end = _around(stretches, number, frames)
        done.append(replace(stretch, chainage_from=start, chainage_to=end))
    return done


def _around(
    stretches: Sequence[Stretch], number: int, frames: Sequence[StretchFrame]
) -> tuple[float | None, float | None]:
    """Return the chainages before and after a stretch, None where they do not belong together."""
    first, last = stretches[number].first, stretches[number].last
    own = [f.chainage for f in frames[first : last + 1] if f.chainage is not None]
    before = frames[first - 1].chainage if first else None
    after = frames[last + 1].chainage if last + 1 < len(frames) else None
    start = before if before is not None else (own[0] if own else None)
    if after is not None and after != 0.0:
        return start, after
    return start, own[-1] if own else None


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None
