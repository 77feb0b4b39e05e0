"""Groups of segments that may form a contour (4.2.2)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.recognition.groups import Group, form_groups

CENTRE = (599.5, 399.5)
DISTANCE, ANGLE, LONG = 8.0, 0.07, 30.0


def groups_of(*rows: tuple[float, float, float, float], most: int = 256) -> list[Group]:
    segments: NDArray[np.float32] = np.array(rows, np.float32).reshape(-1, 4)
    return form_groups(segments, CENTRE, DISTANCE, ANGLE, LONG, most)


def test_segments_along_one_line_form_one_group() -> None:
    groups = groups_of((100, 200, 180, 200), (200, 200, 240, 200), (300, 200, 312, 200))
    assert len(groups) == 1
    assert groups[0].members.tolist() == [0, 1, 2]
    assert groups[0].weight == pytest.approx(80.0 + 40.0 + 12.0)
    theta, rho = groups[0].line
    # y = 200, seen from the centre: 199.5 px up.
    assert rho * math.sin(theta) == pytest.approx(-199.5, abs=1e-4)
    assert math.cos(theta) == pytest.approx(0.0, abs=1e-6)


def test_near_and_parallel_is_what_joins() -> None:
    long = (100.0, 200.0, 200.0, 200.0)
    assert len(groups_of(long, (220, 207, 260, 207))) == 1
    assert len(groups_of(long, (220, 209, 260, 209))) == 2
    assert len(groups_of(long, (220, 200, 260, 200 + 40 * 0.06))) == 1
    assert len(groups_of(long, (220, 198, 260, 198 + 40 * 0.08))) == 2


def test_a_short_segment_starts_no_group() -> None:
    assert groups_of((100, 200, 129, 200)) == []
    groups = groups_of((100, 200, 129, 200), (300, 300, 331, 300))
    assert [group.members.tolist() for group in groups] == [[1]]


def test_the_longest_comes_first_and_makes_the_line() -> None:
    # At y = 206 one is near both others, which are too far from each other: it goes with the
    # longest, and the line of both then leaves the third alone.
    groups = groups_of((300, 206, 360, 206), (100, 200, 200, 200), (400, 213, 450, 213))
    assert [group.members.tolist() for group in groups] == [[0, 1], [2]]
    groups = groups_of((300, 206, 360, 206), (100, 200, 150, 200), (400, 213, 500, 213))
    assert [group.members.tolist() for group in groups] == [[0, 2], [1]]


def test_a_groups_line_follows_those_that_join() -> None:
    # 100 px at y = 200 and 60 px at y = 205: the mean by length is 201.875.
    groups = groups_of((100, 200, 200, 200), (300, 205, 360, 205))
    theta, rho = groups[0].line
    assert rho * math.sin(theta) + CENTRE[1] == pytest.approx(201.875, abs=1e-3)
    # The one that joins contributes by its distance from the line as it was: 60 (1 - 5 / 8).
    assert groups[0].weight == pytest.approx(100.0 + 60.0 * (1.0 - 5.0 / 8.0))
    # y = 209.5 is 9.5 px from the first, but 7.6 from the line of both.
    groups = groups_of((100, 200, 200, 200), (300, 205, 360, 205), (400, 209.5, 450, 209.5))
    assert len(groups) == 1


def test_a_line_up_the_picture_is_one_group_whichever_way_it_leans() -> None:
    # Directions of +89.5 and -89.5 degrees, both ways round.
    lean = 60.0 * math.tan(math.radians(0.5))
    groups = groups_of(
        (500, 100, 500 + lean, 160), (500 + lean, 200, 500, 260), (500, 400, 500 + lean, 340)
    )
    assert len(groups) == 1
    theta, _ = groups[0].line
    assert abs(math.sin(theta)) < 0.02


def test_the_heaviest_group_is_the_first() -> None:
    groups = groups_of((100, 100, 140, 100), (100, 300, 200, 300), (100, 500, 160, 500))
    assert [group.weight for group in groups] == pytest.approx([100.0, 60.0, 40.0])


def test_the_number_of_groups_is_bounded() -> None:
    rows = [(100.0, 20.0 * k, 150.0 + k, 20.0 * k) for k in range(30)]
    groups = groups_of(*rows, most=4)
    # The longest four: the last ones.
    assert sorted(int(group.members[0]) for group in groups) == [26, 27, 28, 29]


def test_no_segments_form_no_groups() -> None:
    assert groups_of() == []
