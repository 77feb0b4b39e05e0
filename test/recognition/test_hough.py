"""The modified Hough transform on hand-made lines (4.2.3)."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.recognition.hough import HoughLine, _peaks, _vote, hough_lines

Array = NDArray[np.float64]
Segments = NDArray[np.float32]

WIDTH, HEIGHT = 1200, 800
CENTRE = np.array([599.5, 399.5])


def broken_line(theta: float, rho: float, noise: float = 0.0, seed: int = 0) -> Segments:
    """Pieces of 40 px with gaps of 20 px of the line (θ, ρ), origin at the picture's centre."""
    random = np.random.default_rng(seed)
    normal = np.array([math.cos(theta), math.sin(theta)])
    along = np.array([-normal[1], normal[0]])
    rows = []
    for start in np.arange(-300.0, 260.0, 60.0):
        ends = [
            CENTRE + (rho + noise * random.normal()) * normal + t * along
            for t in (start, start + 40.0)
        ]
        rows.append(np.concatenate(ends if random.random() < 0.5 else ends[::-1]))
    return np.array(rows, np.float32)


def find(segments: Segments, **options: float) -> list[HoughLine]:
    return hough_lines(segments, (WIDTH, HEIGHT), **options)  # type: ignore[arg-type]


def errors(found: HoughLine, theta: float, rho: float) -> tuple[float, float]:
    """Angle, degrees, and greatest distance within 300 px of the foot, px, from (θ, ρ)."""
    normal = np.array([math.cos(theta), math.sin(theta)])
    turn = math.degrees(abs(math.asin(normal[0] * found.line[1] - normal[1] * found.line[0])))
    foot = CENTRE + rho * normal
    along = np.array([-normal[1], normal[0]])
    off = [abs(found.line[:2] @ (foot + t * along) + found.line[2]) for t in (-300.0, 300.0)]
    return turn, max(off)


ANGLES = (0.0, 0.004, -0.004, 0.3, 1.0, math.pi / 2, 2.0, math.pi - 0.3, math.pi - 0.004)


@pytest.mark.parametrize("rho", [-250.3, -0.2, 0.0, 120.7, 310.0])
@pytest.mark.parametrize("theta", ANGLES)
def test_an_exact_line_is_found_below_a_cell(theta: float, rho: float) -> None:
    found = find(broken_line(theta, rho))
    turn, off = errors(found[0], theta, rho)
    # float32 at 1200 px is good to 6e-5 px.
    assert turn < 0.001
    assert off < 0.01
    assert math.isclose(np.hypot(*found[0].line[:2]), 1.0, abs_tol=1e-12)


@pytest.mark.parametrize("theta", ANGLES)
def test_a_noisy_line_among_clutter_is_found_to_a_part_of_a_pixel(theta: float) -> None:
    random = np.random.default_rng(5)
    middle = random.uniform(0.0, 1.0, (150, 2)) * [WIDTH, HEIGHT]
    angle = random.uniform(0.0, math.pi, 150)
    step = 10.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    clutter = np.column_stack((middle - step, middle + step)).astype(np.float32)
    segments = np.concatenate((clutter, broken_line(theta, 85.0, noise=0.8)))
    turn, off = errors(find(segments)[0], theta, 85.0)
    # Ten pieces with a noise of 0.8 px: 0.25 px in the middle, twice that at the ends.
    assert turn < 0.2
    assert off < 1.2


@pytest.mark.parametrize("rho", [-200.0, 150.0])
def test_a_line_up_the_picture_is_not_torn_in_two_at_the_wrap(rho: float) -> None:
    # Its pieces lean to either side: some normals are just above 0, some just below pi.
    pieces = [broken_line(tilt, rho)[k] for k, tilt in enumerate((0.01, -0.01) * 5)]
    segments = np.array(pieces)
    found = find(segments)
    turn, off = errors(found[0], 0.0, rho)
    assert turn < 0.3
    assert off < 2.0
    # Nearly all of the 400 px stand behind the one line.
    assert found[0].weight > 0.7 * 400.0


def test_lines_on_both_sides_of_the_centre_are_two_lines() -> None:
    for theta in (0.0, math.pi / 2, 1.0):
        pair = np.concatenate((broken_line(theta, -120.0), broken_line(theta, 120.0, seed=1)))
        found = find(pair, most=2)
        rhos = [errors(found[k], theta, rho)[1] for k in (0, 1) for rho in (-120.0, 120.0)]
        assert sorted(rhos)[1] < 0.05
        assert min(rhos[:2]) < 0.05
        assert min(rhos[2:]) < 0.05


def test_the_longer_line_is_the_heavier() -> None:
    long, short = broken_line(0.4, 100.0), broken_line(0.4, -100.0)[:4]
    found = find(np.concatenate((short, long)), most=2)
    assert errors(found[0], 0.4, 100.0)[1] < 0.05
    assert errors(found[1], 0.4, -100.0)[1] < 0.05
    assert found[0].weight > 2.0 * found[1].weight


def test_weights_are_sums_of_contributions() -> None:
    # One segment of 100 px exactly in a cell: it votes there with all its length.
    x = CENTRE[0] + 30.0
    one = np.array([[x, 350.0, x, 450.0]], np.float32)
    assert find(one)[0].weight == pytest.approx(100.0, rel=1e-5)
    # A second one, beside it by half of δ = 6 px, adds the half.
    two = np.concatenate((one, one + np.array([3, 0, 3, 0], np.float32)))
    assert find(two)[0].weight == pytest.approx(150.0, rel=1e-5)


def test_nothing_is_found_where_there_is_nothing() -> None:
    assert find(np.zeros((0, 4), np.float32)) == []
    assert find(np.array([[100, 100, 110, 100]], np.float32)) == []


def test_no_more_lines_than_asked_for() -> None:
    many = np.concatenate([broken_line(0.2 * k, 20.0 * k) for k in range(8)])
    assert len(find(many, most=3)) == 3


@given(st.randoms(use_true_random=False))
@settings(max_examples=10)
def test_the_order_and_sense_of_segments_do_not_matter(random: Random) -> None:
    segments = np.concatenate((broken_line(0.7, 50.0, 0.5), broken_line(2.9, -80.0, 0.5)))
    order = list(range(len(segments)))
    random.shuffle(order)
    other = segments[order]
    other[::2] = other[::2][:, [2, 3, 0, 1]]
    for a, b in zip(find(segments)[:2], find(other)[:2], strict=True):
        assert abs(abs(a.line[:2] @ b.line[:2]) - 1.0) < 1e-9
        assert a.weight == pytest.approx(b.weight, rel=1e-5)


def test_votes_agree_with_a_slow_reference() -> None:
    random = np.random.default_rng(3)
    step, rho_step, spread, distance = math.pi / 40, 2.0, 0.25, 6.0
    half = 30
    middles = random.uniform(-40.0, 40.0, (25, 2))
    normals = random.uniform(0.0, math.pi, 25)
    normals[:6] = [0.0, 0.01, math.pi - 0.01, 0.1, math.pi - 0.1, math.pi / 2]
    lengths = random.uniform(10.0, 40.0, 25)
    table = np.zeros((40, 2 * half + 1), np.float32)
    _vote(middles, normals, lengths, step, rho_step, spread, distance, table)

    expected = np.zeros(table.shape)
    for (x, y), normal, length in zip(middles, normals, lengths, strict=True):
        for row in range(40):
            for column in range(2 * half + 1):
                # The line of the cell under both of its names.
                for turned in (-1, 0, 1):
                    theta = (row + 40 * turned) * step
                    rho = (column - half) * rho_step * (-1.0 if turned else 1.0)
                    cells = row + 40 * turned - round(normal / step)
                    off = abs(x * math.cos(theta) + y * math.sin(theta) - rho)
                    if abs(cells) <= int(spread / step) and off <= distance:
                        w = length * math.cos(theta - normal) * (1.0 - off / distance)
                        expected[row, column] += w
    assert np.allclose(table, expected, atol=1e-4)
    assert expected.max() > 0.0


def test_peaks_are_cleared_round_the_wrap_too() -> None:
    table = np.zeros((40, 61), np.float32)
    table[0, 30 + 12] = 10.0
    table[39, 30 - 12] = 9.0  # the same line but for one cell of angle
    table[39, 30 + 12] = 8.0  # another line: rho has the other sign there
    cells = np.empty((5, 2), np.int64)
    weights = np.empty(5)
    count = _peaks(table, 1.0, 3, 5, cells, weights)
    assert cells[:count].tolist() == [[0, 42], [39, 42]]
    assert weights[:count].tolist() == [10.0, 8.0]
