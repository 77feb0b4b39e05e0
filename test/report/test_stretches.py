"""Stretches: where the pipe was followed, how it lies there, and where it was lost."""

from __future__ import annotations

import pytest

from pipeline_tracker.report.stretches import (
    Course,
    Lie,
    StretchFrame,
    clearance,
    course_of,
    find_stretches,
    frame_of_row,
    lie_of,
)

RADIUS = 0.3


def frame(
    number: int, chainage: float | None, *, bed: float | None = RADIUS, reason: str = ""
) -> StretchFrame:
    """Return a frame that was followed, or one that was lost for a reason."""
    course = Course.SEARCHING if reason else Course.FOLLOWED
    return StretchFrame(number * 10**9, course, reason, chainage, bed, bed)


def test_each_frame_is_in_one_stretch_and_chainages_leave_no_gap() -> None:
    frames = [frame(k, 0.5 * k) for k in range(4)]
    frames += [frame(k, None, bed=None, reason="pipe_not_found") for k in range(4, 7)]
    frames += [frame(k, 0.5 * k) for k in range(7, 10)]
    stretches = find_stretches(frames, RADIUS)
    assert [(s.first, s.last, s.course) for s in stretches] == [
        (0, 3, Course.FOLLOWED),
        (4, 6, Course.SEARCHING),
        (7, 9, Course.FOLLOWED),
    ]
    chainages = [(s.chainage_from, s.chainage_to) for s in stretches]
    assert chainages == [(0.0, 1.5), (1.5, 3.5), (3.5, 4.5)]
    assert [s.length for s in stretches] == [1.5, 2.0, 1.0]
    assert stretches[1].reasons == (("pipe_not_found", 3),)
    assert stretches[1].lie is Lie.NOT_KNOWN
    assert (stretches[1].start_ns, stretches[1].end_ns, stretches[1].frames) == (
        4 * 10**9,
        6 * 10**9,
        3,
    )


@pytest.mark.parametrize(
    ("heights", "lie", "clear"),
    [
        ((0.55, 0.45), Lie.FREE_SPAN, 0.2),
        ((0.50, 0.10), Lie.ON_BED, 0.0),  # a bed that slopes across the pipe
        ((0.15, 0.15), Lie.PARTLY_BURIED, -0.15),
        ((-0.05, -0.05), Lie.MORE_THAN_HALF_BURIED, -0.35),
        ((0.5, None), Lie.NOT_KNOWN, None),
    ],
)
def test_the_lie_is_that_of_the_bed_on_both_sides(
    heights: tuple[float, float | None], lie: Lie, clear: float | None
) -> None:
    measured = clearance(*heights, RADIUS)
    assert measured == (None if clear is None else pytest.approx(clear))
    assert lie_of(measured, RADIUS) is lie


def test_a_free_span_is_a_stretch_of_its_own_and_a_single_outlier_is_none() -> None:
    bed = [0.3] * 8 + [0.6] * 6 + [0.3] * 6
    bed[3] = 0.9
    frames = [frame(k, 0.5 * k, bed=height) for k, height in enumerate(bed)]
    stretches = find_stretches(frames, RADIUS)
    assert [(s.first, s.last, s.lie) for s in stretches] == [
        (0, 7, Lie.ON_BED),
        (8, 13, Lie.FREE_SPAN),
        (14, 19, Lie.ON_BED),
    ]
    assert stretches[1].clearance == pytest.approx(0.3)
    assert [s.chainage_from for s in stretches] == [0.0, 3.5, 6.5]
    assert sum(s.length or 0.0 for s in stretches) == 9.5


def test_a_stretch_whose_first_frame_alone_differs_is_one() -> None:
    frames = [frame(k, 0.5 * k, bed=0.9 if k < 2 else 0.3) for k in range(12)]
    assert [(s.first, s.last) for s in find_stretches(frames, RADIUS)] == [(0, 11)]


def test_a_chainage_that_starts_anew_begins_a_stretch() -> None:
    frames = [frame(k, 0.5 * k) for k in range(4)]
    lost = frame(4, None, bed=None, reason="pose_jump")
    again = [frame(k, 0.5 * (k - 5)) for k in range(5, 9)]
    assert [s.length for s in find_stretches([*frames, *again], RADIUS)] == [1.5, 1.5]
    stretches = find_stretches([*frames, lost, *again], RADIUS)
    assert [s.length for s in stretches] == [1.5, None, 1.5]
    assert stretches[1].chainage_from == 1.5


def test_a_vehicle_that_turns_round_and_one_without_chainage() -> None:
    back = find_stretches([frame(k, 3.0 - k) for k in range(3)], RADIUS)
    assert (back[0].chainage_from, back[0].chainage_to, back[0].length) == (3.0, 1.0, 2.0)
    alone = find_stretches([frame(k, None) for k in range(3)], RADIUS)
    assert len(alone) == 1
    assert alone[0].length is None
    assert find_stretches([], RADIUS) == []


def test_coasting_is_told_apart_from_searching() -> None:
    coasting = StretchFrame(10**9, Course.COASTING, "cameras_disagree", 0.5)
    searching = StretchFrame(2 * 10**9, Course.SEARCHING, "pipe_not_found")
    frames = [frame(0, 0.0), coasting, searching, frame(3, 1.5)]
    stretches = find_stretches(frames, RADIUS)
    assert [s.course for s in stretches] == [f.course for f in frames]
    assert [(s.chainage_from, s.chainage_to) for s in stretches[1:3]] == [(0.0, 0.5), (0.5, 1.5)]


def test_rows_of_the_table_are_read() -> None:
    row = {"stamp_ns": "5", "state": "tracking", "valid": "1", "reason": "", "chainage": "1.5"}
    assert frame_of_row(row) == StretchFrame(5, Course.FOLLOWED, "", 1.5)
    beside = frame_of_row({**row, "bed_left": "0.31", "bed_right": ""})
    assert (beside.bed_left, beside.bed_right) == (0.31, None)
    assert course_of("", valid=False) is Course.NOT_PROCESSED
    assert course_of("tracking", valid=False) is Course.SEARCHING
    with pytest.raises(ValueError, match="could not convert"):
        frame_of_row({**row, "chainage": "wide"})
