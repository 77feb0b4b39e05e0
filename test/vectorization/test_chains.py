"""Splitting and fitting of chains against slow plain references."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.vectorization.chains import _fit, _follow, _heading, _split, trace_segments
from pipeline_tracker.vectorization.edges import NO_EDGE, STRONG, WEAK

Array = NDArray[np.float64]


def chain(seed: int, count: int = 60) -> NDArray[np.float32]:
    """A random walk that goes mostly to the right."""
    random = np.random.default_rng(seed)
    turns = np.cumsum(random.normal(0.0, 0.25, count))
    steps = np.column_stack((np.cos(turns), np.sin(turns)))
    return np.cumsum(steps, axis=0).astype(np.float32) + np.float32(100.0)


def slow_split(points: Array, first: int, last: int, tolerance: float) -> list[int]:
    """Ramer, Douglas and Peucker, by recursion."""
    if last - first < 2:
        return [first]
    chord = points[last] - points[first]
    away = points[first + 1 : last] - points[first]
    distance = np.abs(away[:, 0] * chord[1] - away[:, 1] * chord[0]) / np.linalg.norm(chord)
    worst = int(np.argmax(distance))
    if distance[worst] <= tolerance:
        return [first]
    corner = first + 1 + worst
    return slow_split(points, first, corner, tolerance) + slow_split(
        points, corner, last, tolerance
    )


def split(points: NDArray[np.float32], tolerance: float) -> list[int]:
    xs, ys = np.ascontiguousarray(points.T)
    n = len(points)
    # What was left in the arrays before must not matter.
    breaks, keep = np.full(n, 7, np.int64), np.ones(n, np.uint8)
    count = _split(xs, ys, tolerance, breaks, keep, np.full(2 * n, 7, np.int64))
    return [int(corner) for corner in breaks[:count]]


@given(st.integers(0, 10_000), st.floats(0.3, 4.0))
@settings(max_examples=40)
def test_a_chain_is_split_as_by_a_slow_reference(seed: int, tolerance: float) -> None:
    points = chain(seed)
    last = len(points) - 1
    expected = [*slow_split(points.astype(np.float64), 0, last, tolerance), last]
    assert split(points, tolerance) == expected


def test_a_closed_chain_is_split_too() -> None:
    # Its chord has no length: the furthest point is the first corner.
    turn = np.linspace(0.0, 2.0 * math.pi, 101)
    points = (50.0 + 20.0 * np.column_stack((np.cos(turn), np.sin(turn)))).astype(np.float32)
    points[-1] = points[0]
    corners = split(points, 1.0)
    assert corners[0] == 0
    assert corners[-1] == 100
    assert 50 in corners


@given(st.integers(0, 10_000), st.integers(0, 20), st.integers(30, 59))
@settings(max_examples=40)
def test_a_line_is_fitted_across_as_by_singular_values(seed: int, first: int, last: int) -> None:
    points = chain(seed)
    out = np.empty(4, np.float32)
    xs, ys = np.ascontiguousarray(points.T)
    length = _fit(xs, ys, first, last, out)
    part = points[first : last + 1].astype(np.float64)
    centre = part.mean(axis=0)
    _, values, vectors = np.linalg.svd(part - centre)
    ends = out.astype(np.float64).reshape(2, 2)
    if values[0] > 1.1 * values[1]:
        # Both ends lie on the best line, where the first and the last point project on it.
        assert np.abs((ends - centre) @ vectors[1]).max() < 1e-3
        expected = (part[[0, -1]] - centre) @ vectors[0]
        assert np.allclose((ends - centre) @ vectors[0], expected, atol=1e-3)
        assert length == pytest.approx(abs(expected[1] - expected[0]), abs=1e-3)
    assert np.dot(ends[1] - ends[0], part[-1] - part[0]) >= 0.0


def test_a_heading_is_the_direction_nearest_to_the_edge() -> None:
    for degrees in range(0, 360, 5):
        gx, gy = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        # A quarter turn before the gradient, as one looks at the picture (y is down).
        along = math.degrees(math.atan2(-gx, gy))
        assert _heading(gx, gy) == round(along / 45.0) % 8


def slow_follow(
    ridge: NDArray[np.uint8],
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    place: tuple[int, int],
    heading: int,
) -> list[tuple[int, int]]:
    """Straight on, then 45 and 90 degrees aside, to alike gradients, pixel by pixel."""
    taken: list[tuple[int, int]] = []
    while True:
        y, x = place
        here = np.array([dx[place], dy[place]], np.float64)
        for turn in (0, 1, -1, 2, -2):
            angle = (heading + turn) % 8 * math.pi / 4
            there = y + round(math.sin(angle)), x + round(math.cos(angle))
            gradient = np.array([dx[there], dy[there]], np.float64)
            least = math.sqrt(0.5) * np.linalg.norm(here) * np.linalg.norm(gradient)
            if ridge[there] and here @ gradient >= least - 1e-6:
                heading = (heading + turn) % 8
                break
        else:
            return taken
        place = there
        ridge[place] = NO_EDGE
        taken.append(place)


@given(st.integers(0, 10_000), st.integers(0, 7), st.sampled_from([1, -1]))
@settings(max_examples=60)
def test_an_edge_is_followed_as_by_a_slow_reference(seed: int, heading: int, side: int) -> None:
    random = np.random.default_rng(seed)
    shape = 30, 37
    ridge = (random.random(shape) < 0.6).astype(np.uint8)
    ridge[:2] = ridge[-2:] = ridge[:, :2] = ridge[:, -2:] = NO_EDGE
    angle = random.normal(1.0, 0.5, shape)
    dx = np.rint(100.0 * np.cos(angle)).astype(np.int16)
    dy = np.rint(90.0 * np.sin(angle)).astype(np.int16)
    ridge[15, 18] = NO_EDGE
    expected_ridge = ridge.copy()
    expected = slow_follow(expected_ridge, dx, dy, (15, 18), heading)
    steps = np.array([1, 38, 37, 36, -1, -38, -37, -36], np.int64)
    out = np.zeros(2 * ridge.size + 1, np.int64)
    place = 15 * 37 + 18
    count = _follow(ridge.ravel(), dx.ravel(), dy.ravel(), place, steps, heading, out, side)
    found = out[ridge.size + side : ridge.size + side * (count + 1) : side] if count else out[:0]
    assert [divmod(int(p), 37) for p in found] == expected
    assert (ridge == expected_ridge).all()


def test_a_chain_ends_where_its_room_does() -> None:
    ridge = np.zeros((5, 40), np.uint8)
    ridge[2, 2:38] = STRONG
    dx, dy = np.zeros(ridge.shape, np.int16), np.full(ridge.shape, 50, np.int16)
    steps = np.array([1, 41, 40, 39, -1, -41, -40, -39], np.int64)
    out = np.full(21, -1, np.int64)
    count = _follow(ridge.ravel(), dx.ravel(), dy.ravel(), 82, steps, 0, out, 1)
    assert count == 10
    assert out.tolist() == [-1] * 11 + list(range(83, 93))


def edges(height: int = 40, width: int = 60) -> dict[str, NDArray[np.generic]]:
    return {
        "ridge": np.zeros((height, width), np.uint8),
        "dx": np.zeros((height, width), np.int16),
        "dy": np.zeros((height, width), np.int16),
    }


def trace(picture: dict[str, NDArray[np.generic]], min_length: float = 10.0) -> NDArray[np.float32]:
    dx, dy = picture["dx"], picture["dy"]
    magnitude = np.hypot(dx.astype(np.float64), dy.astype(np.float64)).astype(np.float32)
    return trace_segments(
        picture["ridge"],  # type: ignore[arg-type]
        dx,  # type: ignore[arg-type]
        dy,  # type: ignore[arg-type]
        magnitude,
        1.2,
        min_length,
    )


def test_one_strong_pixel_brings_the_whole_weak_edge() -> None:
    picture = edges()
    picture["ridge"][20, 10:50] = WEAK
    picture["dy"][20, 10:50] = 60
    assert len(trace(picture)) == 0
    picture["ridge"][20, 10:50] = WEAK
    picture["ridge"][20, 33] = STRONG
    # Bright below: seen along 1 -> 2 the brighter side is to the right, so it runs to the right.
    assert trace(picture).tolist() == [[10.0, 20.0, 49.0, 20.0]]


def test_the_edge_is_moved_along_the_gradient_to_its_ridge() -> None:
    picture = edges()
    picture["ridge"][5:35, 30] = STRONG
    # The parabola through 80, 120, 100 has its top a sixth of a pixel to the side of the 100.
    for column, value in ((29, -100), (30, -120), (31, -80)):
        picture["dx"][5:35, column] = value
    # Brighter to the left, the edge runs down the picture.
    found = trace(picture)
    assert found[0] == pytest.approx([30.0 - 1.0 / 6.0, 5.0, 30.0 - 1.0 / 6.0, 34.0], abs=1e-5)
    assert len(found) == 1


def test_a_chain_does_not_change_to_the_other_side_of_a_thin_line() -> None:
    # Two edges side by side with opposite gradients: a bright line two pixels wide.
    picture = edges()
    picture["ridge"][19:21, 10:50] = STRONG
    picture["dy"][19, 10:50] = 120
    picture["dy"][20, 10:50] = -120
    picture["dy"][18, 10:50] = 120
    picture["dy"][21, 10:50] = -120
    found = sorted(trace(picture).tolist())
    # Alike magnitudes on both sides leave each where it is.
    assert found == [[10.0, 19.0, 49.0, 19.0], [49.0, 20.0, 10.0, 20.0]]


def test_each_pixel_belongs_to_one_chain_so_that_chains_end_at_junctions() -> None:
    # A T: an edge that runs into the middle of another one, gradients 45 degrees apart.
    picture = edges()
    picture["ridge"][10, 5:55] = STRONG
    picture["dy"][10, 5:55] = 120
    for k in range(1, 25):
        picture["ridge"][10 + k, 30 + k // 2] = STRONG
        picture["dx"][10 + k, 30 + k // 2] = 100
        picture["dy"][10 + k, 30 + k // 2] = -100
    found = trace(picture)
    assert len(found) == 2
    assert (picture["ridge"] == NO_EDGE).all()
    level = found[np.abs(found[:, 1] - found[:, 3]) < 0.1]
    assert len(level) == 1
    assert level[0] == pytest.approx([5.0, 10.0, 54.0, 10.0], abs=0.1)
