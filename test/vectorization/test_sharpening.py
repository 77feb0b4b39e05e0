"""Segments put to where an image is steepest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pictures import Bar

from pipeline_tracker.vectorization.sharpening import _fit_line, sharpen

Array = NDArray[np.float64]


def on_edge(bar: Bar, side: int, length: float) -> Array:
    """A segment on an edge of a bar, the brighter inside to its right; (4,) px."""
    middle = np.array([(bar.width - 1) / 2.0, (bar.height - 1) / 2.0])
    at = middle - bar.normal * bar.across(middle) + side * 0.5 * bar.thickness * bar.normal
    # Right of (ux, uy), as one looks at the picture, is (-uy, ux).
    inward = -side * bar.normal
    way = 0.5 * length * np.array([inward[1], -inward[0]])
    return np.concatenate((at - way, at + way))


def off_edge(segment: Array, bar: Bar, side: int) -> Array:
    """Signed distance of both ends from an edge, px."""
    return np.asarray(bar.across(segment.reshape(2, 2)) - side * 0.5 * bar.thickness)


@pytest.mark.parametrize("degrees", [0, 7, 45, 90, 113, 158])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("first", "last"), [(1.2, 1.2), (-1.4, 0.7), (0.4, -1.0)])
def test_a_segment_is_moved_and_turned_onto_its_edge(
    degrees: float, side: int, first: float, last: float
) -> None:
    bar = Bar(angle=math.radians(degrees), offset=0.3)
    true = on_edge(bar, side, 90.0)
    moved = true + np.concatenate((first * bar.normal, last * bar.normal))
    segments = moved.astype(np.float32)[None]
    sharpen(bar.image(180.0, 70.0), segments)
    assert np.abs(off_edge(segments[0].astype(np.float64), bar, side)).max() < 0.12
    # Across it only: it is as long as before.
    assert np.abs(segments[0] - true).max() < 0.2


def test_an_edge_of_the_other_polarity_draws_nothing() -> None:
    bar = Bar(angle=0.4)
    for low, high in ((70.0, 180.0), (180.0, 70.0)):
        segments = (on_edge(bar, 1, 60.0) + np.tile(0.8 * bar.normal, 2)).astype(np.float32)[None]
        before = segments.copy()
        sharpen(bar.image(high, low), segments)
        assert np.array_equal(segments, before) == (high < low)


def test_it_stays_where_no_edge_is_near() -> None:
    flat = np.full((100, 140), 90, np.uint8)
    segments = np.array([[20, 30, 90, 60], [0, 0, 139, 99], [50, 50, 50, 50]], np.float32)
    before = segments.copy()
    sharpen(flat, segments)
    assert np.array_equal(segments, before)
    bar = Bar(angle=0.4)
    far = (on_edge(bar, 1, 60.0) + np.tile(9.0 * bar.normal, 2)).astype(np.float32)[None]
    before = far.copy()
    sharpen(bar.image(180.0, 70.0), far)
    assert np.array_equal(far, before)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (6, 6), (40, 3)])
def test_tiny_images_are_taken(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    segments = np.array([[0, 0, shape[1] - 1, shape[0] - 1]], np.float32)
    sharpen(image, segments)
    assert np.isfinite(segments).all()


def test_a_line_is_fitted_as_by_a_slow_reference() -> None:
    random = np.random.default_rng(3)
    way = np.linspace(-40.0, 40.0, 11)
    off = 0.4 + 0.01 * way + random.normal(0.0, 0.1, 11)
    off[3] += 1.5
    weight = random.uniform(20.0, 60.0, 11)
    out = np.empty(2)
    assert _fit_line(np.column_stack((way, off, weight)), 11, out)
    line = np.zeros(2)
    for turn in range(3):
        own = weight / (1.0 + np.square((off - line[0] - line[1] * way) / 0.5) * (turn > 0))
        slope, level = np.polyfit(way, off, 1, w=np.sqrt(own))
        line = np.array([level, slope])
    assert out == pytest.approx(line, abs=1e-9)
    # One place that is off has hardly moved it.
    assert np.abs(out - [0.4, 0.01]).max() < 0.12
    assert not _fit_line(np.column_stack((way, off, weight)), 1, out)
