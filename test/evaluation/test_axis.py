"""Distances from a polyline against a search over dense points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.evaluation.axis import TrueAxis, divergence

Array = NDArray[np.float64]

coordinates = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@given(st.lists(coordinates, min_size=2, max_size=8, unique=True), coordinates)
def test_nearest_point_against_a_dense_search(
    vertices: list[tuple[float, float, float]], place: tuple[float, float, float]
) -> None:
    line, point = np.array(vertices), np.array(place)
    assume(np.linalg.norm(np.diff(line, axis=0), axis=1).min() > 1e-5)
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in pairwise(line)])
    found = TrueAxis([line]).nearest(point)
    best = np.linalg.norm(dense - point, axis=1).min()
    # Never further than the best sample, never nearer than the spacing of samples allows.
    assert np.linalg.norm(found - point) <= best + 1e-12
    assert np.linalg.norm(found - point) == pytest.approx(best, abs=0.01)
    assert np.linalg.norm(dense - found, axis=1).min() < 0.01


def test_overlapping_stretches_are_one_axis() -> None:
    x = np.arange(0.0, 10.0, 0.1)
    line = np.stack((x, np.sin(x), 0.1 * x), axis=1)
    whole, parts = TrueAxis([line]), TrueAxis([line[i : i + 30] for i in range(0, 70, 5)])
    rng = np.random.default_rng(2)
    for point in rng.uniform([0.0, -1.0, -1.0], [8.0, 2.0, 2.0], (50, 3)):
        np.testing.assert_allclose(parts.nearest(point), whole.nearest(point), atol=1e-12)


def test_stretches_with_other_vertices_are_one_finer_axis() -> None:
    # Each has every fifth vertex of a bend, beginning with another one.
    angle = np.arange(0.0, 1.0, 0.02 / 20.0)
    arc = 20.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle), 0.1 * angle), axis=1)
    fine, parts = TrueAxis([arc]), TrueAxis([arc[i::5] for i in range(5)])
    rng = np.random.default_rng(4)
    for point in arc[rng.integers(20, 900, 100)] + rng.normal(0.0, 0.001, (100, 3)):
        np.testing.assert_allclose(parts.nearest(point), fine.nearest(point), atol=1e-9)
        np.testing.assert_allclose(parts.tangent(point), fine.tangent(point), atol=1e-6)


def test_the_tangent_is_that_of_the_nearest_piece() -> None:
    axis = TrueAxis([np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 3.0, 4.0]])])
    np.testing.assert_allclose(axis.tangent(np.array([0.3, 0.1, 0.0])), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(axis.tangent(np.array([1.2, 3.0, 3.9])), [0.0, 0.6, 0.8])


@pytest.mark.parametrize(
    "polylines", [[], [np.zeros((0, 3))], [np.zeros((1, 3))], [np.zeros((3, 3))]]
)
def test_nothing_is_no_axis(polylines: list[Array]) -> None:
    axis = TrueAxis(polylines)
    assert axis.empty
    with pytest.raises(ValueError, match="no axis"):
        axis.nearest(np.zeros(3))


def test_divergence_is_the_sum_over_both_ends() -> None:
    axis = TrueAxis([np.array([[-9.0, 0.0, 0.0], [9.0, 0.0, 0.0]])])
    found = divergence(np.array([0.0, 0.03, 0.04]), np.array([0.5, -0.06, -0.08]), axis)
    assert found.ends == pytest.approx((0.05, 0.10))
    assert found.horizontal == pytest.approx(0.09)
    assert found.vertical == pytest.approx(0.12)
    assert found.total == pytest.approx(0.15)


def test_on_a_bend_the_polyline_is_as_good_as_its_chords() -> None:
    angle = np.arange(0.0, 1.0, 0.1 / 20.0)
    arc = 20.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle), axis=1)
    middle = (angle[10] + angle[11]) / 2.0
    point = 20.0 * np.array([math.sin(middle), 1.0 - math.cos(middle), 0.0])
    off = np.linalg.norm(TrueAxis([arc]).nearest(point) - point)
    # The chord's height: spacing squared by eight radii.
    assert off == pytest.approx(0.1**2 / (8 * 20.0), rel=0.01)
