"""Contribution of segments to lines (4.1.3): values by hand, and slow plain references."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.voting import (
    contribution,
    line_support,
    middles_of,
    support_by_middles,
)

Array = NDArray[np.float64]

DISTANCE, ANGLE = 6.0, 0.12
# A finite line along a row: 100 px long, from x = 50 to x = 150.
LINE = np.array([50.0, 200.0, 150.0, 200.0])


def support(*segments: tuple[float, float, float, float], line: Array = LINE) -> float:
    found = np.array(segments, np.float32).reshape(-1, 4)
    total, length = line_support(found, line, DISTANCE, ANGLE, np.zeros(400))
    assert length == pytest.approx(math.hypot(line[2] - line[0], line[3] - line[1]))
    return total


def test_a_segment_on_the_line_contributes_its_length() -> None:
    assert support((60, 200, 100, 200)) == pytest.approx(40.0)


def test_the_contribution_falls_off_linearly_with_the_distance_of_the_middle() -> None:
    assert support((60, 203, 100, 203)) == pytest.approx(0.5 * 40.0)
    assert support((60, 195.5, 100, 195.5)) == pytest.approx(0.25 * 40.0)
    assert support((60, 206, 100, 206)) == 0.0
    assert support((60, 207, 100, 207)) == 0.0


def test_it_counts_with_the_cosine_of_its_angle_up_to_the_threshold() -> None:
    # Through (80, 200) with 0.1 rad: the projection is what counts.
    half = 20.0 * np.array([math.cos(0.1), math.sin(0.1)])
    expected = 40.0 * math.cos(0.1)
    got = support((80 - half[0], 200 - half[1], 80 + half[0], 200 + half[1]))
    assert got == pytest.approx(expected, rel=1e-5)
    half = 20.0 * np.array([math.cos(0.13), math.sin(0.13)])
    assert support((80 - half[0], 200 - half[1], 80 + half[0], 200 + half[1])) == 0.0


def test_only_the_part_inside_the_finite_line_counts() -> None:
    assert support((0, 200, 80, 200)) == pytest.approx(30.0)
    assert support((140, 200, 300, 200)) == pytest.approx(10.0)
    assert support((0, 200, 300, 200)) == pytest.approx(100.0)
    assert support((0, 200, 49, 200)) == 0.0
    assert support((151, 200, 300, 200)) == 0.0


def test_overlapping_segments_count_once_with_the_best_of_them() -> None:
    twice = ((60, 200, 100, 200), (60, 200, 100, 200))
    assert support(*twice) == pytest.approx(40.0)
    # A better and a worse one: 60 to 80 in full, 80 to 100 in full, 100 to 120 by half.
    assert support((60, 200, 100, 200), (80, 203, 120, 203)) == pytest.approx(40.0 + 0.5 * 20.0)
    # One after the other they add up.
    assert support((60, 200, 80, 200), (80, 200, 110, 200)) == pytest.approx(50.0)


def test_the_sense_of_segment_and_line_does_not_matter() -> None:
    forth = support((60, 202, 97, 201))
    assert support((97, 201, 60, 202)) == pytest.approx(forth)
    assert support((60, 202, 97, 201), line=LINE[[2, 3, 0, 1]]) == pytest.approx(forth, abs=1e-3)


def test_nothing_contributes_nothing() -> None:
    assert support() == 0.0
    assert support((80, 200, 80, 200)) == 0.0
    point = np.array([50.0, 200.0, 50.0, 200.0])
    found = np.array([[60, 200, 100, 200]], np.float32)
    assert line_support(found, point, DISTANCE, ANGLE, np.zeros(4)) == (0.0, 0.0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_a_number_that_is_none_contributes_nothing(place: int, value: float) -> None:
    segment = [60.0, 200.0, 100.0, 200.0]
    segment[place] = value
    good = (110.0, 200.0, 130.0, 200.0)
    assert support(tuple(segment), good) == pytest.approx(20.0)  # type: ignore[arg-type]
    line = np.array([0.0, 1.0, -200.0])
    with np.errstate(invalid="ignore"):
        assert contribution(np.array(segment, np.float32), line, DISTANCE, ANGLE) == 0.0


def test_one_segment_and_an_infinite_line() -> None:
    line = np.array([0.0, 1.0, -200.0])
    segment = np.array([60, 203, 100, 203], np.float32)
    assert contribution(segment, line, DISTANCE, ANGLE) == pytest.approx(20.0)
    assert contribution(segment, -line, DISTANCE, ANGLE) == pytest.approx(20.0)
    steep = np.array([60, 190, 70, 210], np.float32)
    assert contribution(steep, line, DISTANCE, ANGLE) == 0.0
    far = np.array([60, 207, 100, 207], np.float32)
    assert contribution(far, line, DISTANCE, ANGLE) == 0.0
    assert contribution(np.zeros(4, np.float32), np.array([0.0, 1.0, 0.0]), 6.0, 0.12) == 0.0


numbers = st.floats(0.0, 120.0, width=32)
segments_near = st.lists(st.tuples(numbers, st.floats(-8, 8, width=32), numbers), max_size=12)


@given(segments_near, st.floats(0.0, math.pi), st.floats(20.0, 150.0))
@settings(max_examples=50)
def test_it_agrees_with_a_slow_reference(
    found: list[tuple[float, float, float]], turn: float, length: float
) -> None:
    # Segments nearly along a line that runs at an angle through (200, 200).
    along = np.array([math.cos(turn), math.sin(turn)])
    across = np.array([-along[1], along[0]])
    origin = np.array([200.0, 200.0])
    rows = [
        np.concatenate((origin + a * along + r * across, origin + b * along + (r + 1) * across))
        for a, r, b in found
    ]
    segments = np.array(rows, np.float32).reshape(-1, 4)
    line = np.concatenate((origin, origin + length * along))
    total, _ = line_support(segments, line, DISTANCE, ANGLE, np.zeros(400))

    # Walk along the line in steps of 1/50 px and take the best segment at each place.
    places = np.arange(0.01, length, 0.02)
    best = np.zeros(len(places))
    ends = 0
    for x1, y1, x2, y2 in segments.astype(np.float64):
        step = np.array([x2 - x1, y2 - y1])
        middle = np.array([x1 + x2, y1 + y2]) / 2 - origin
        r = abs(middle @ across)
        if r > DISTANCE or abs(step @ along) < math.cos(ANGLE) * np.linalg.norm(step):
            continue
        a, b = sorted(((x1, y1) - origin) @ along for x1, y1 in ((x1, y1), (x2, y2)))
        inside = (places >= a) & (places <= b)
        best[inside] = np.maximum(best[inside], 1.0 - r / DISTANCE)
        ends += 2
    # In a pixel in which segments end only the best of them counts.
    assert abs(total - 0.02 * best.sum()) < 0.1 + 0.5 * ends


@given(segments_near)
@settings(max_examples=20)
def test_support_is_never_more_than_the_line_nor_less_for_more_segments(
    found: list[tuple[float, float, float]],
) -> None:
    rows = [(50 + a, 200 + r, 50 + b, 200 + r) for a, r, b in found]
    total = support(*rows)
    assert 0.0 <= total <= 100.0 + 1e-9
    assert total >= support(*rows[1:]) - 1e-9


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.05, 0.8, math.pi / 2, 3.1, math.pi])
def test_a_line_among_many_is_supported_as_one_alone(turn: float) -> None:
    # Points, and numbers that are none, support nothing.
    random = np.random.default_rng(round(100 * turn))
    middles = random.uniform(180.0, 220.0, (300, 2))
    angles = turn + random.normal(0.0, 0.15, 300)
    half = np.column_stack((np.cos(angles), np.sin(angles))) * random.uniform(2.0, 30.0, (300, 1))
    segments = np.hstack((middles - half, middles + half)).astype(np.float32)
    segments[::50] = segments[::50, [0, 1, 0, 1]]
    segments[7] = np.nan
    along = np.array([math.cos(turn), math.sin(turn)])
    off_line = np.empty(300)
    for off in (0.0, 4.0):
        start = np.array([200.0, 200.0]) - 60.0 * along + off * along[::-1]
        line = np.concatenate((start, start + 120.0 * along))
        plain, _ = line_support(segments, line, DISTANCE, ANGLE, np.zeros(400))
        fast = support_by_middles(
            segments, middles_of(segments), line, DISTANCE, ANGLE, np.zeros(400), off_line
        )
        assert plain > 50.0
        assert fast == pytest.approx(plain, rel=1e-9)


def test_no_segments_support_nothing() -> None:
    none = np.zeros((0, 4), np.float32)
    off = np.empty(0)
    scratch = np.zeros(400)
    assert support_by_middles(none, middles_of(none), LINE, DISTANCE, ANGLE, scratch, off) == 0.0
