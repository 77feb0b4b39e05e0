"""Straight segments of pictures whose edges are known below a pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pictures import Bar

from pipeline_tracker.vectorization.segments import (
    extract_segments,
    pyramid,
    shrink,
    to_full_size,
)

Array = NDArray[np.float64]

DEGREES = (0, 1, 7, 22.5, 45, 60, 89, 90, 91, 113, 135, 158, 179)


def segments_of(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    return extract_segments(image, 1.2, 12.0)


def off_edges(segments: NDArray[np.float32], bar: Bar) -> tuple[Array, Array]:
    """Distance of each end from the nearer edge, px, and that edge's side, -1 or +1; (N, 2)."""
    across = bar.across(segments.astype(np.float64).reshape(-1, 2)).reshape(-1, 2)
    return np.abs(np.abs(across) - 0.5 * bar.thickness), np.sign(across)


def lengths(segments: NDArray[np.float32]) -> Array:
    step = (segments[:, 2:] - segments[:, :2]).astype(np.float64)
    return np.asarray(np.hypot(step[:, 0], step[:, 1]))


@pytest.mark.parametrize("bright", [True, False], ids=["bright", "dark"])
@pytest.mark.parametrize("offset", [0.0, 0.3, -7.45])
@pytest.mark.parametrize("degrees", DEGREES)
def test_edges_are_found_to_a_part_of_a_pixel(degrees: float, offset: float, bright: bool) -> None:
    bar = Bar(angle=math.radians(degrees), offset=offset)
    segments = segments_of(bar.image(*((180.0, 70.0) if bright else (70.0, 180.0))))
    off, sides = off_edges(segments, bar)
    assert off.max() < 0.15
    assert (sides[:, 0] == sides[:, 1]).all()
    # Both edges, and nearly all of each.
    for side in (-1, 1):
        found = lengths(segments[sides[:, 0] == side]).sum()
        assert found > 0.9 * bar.visible_length(side)
    # The brighter side lies to the right of 1 -> 2.
    step = (segments[:, 2:] - segments[:, :2]).astype(np.float64)
    rightward = np.column_stack((-step[:, 1], step[:, 0])) @ bar.normal
    inward = -sides[:, 0]
    assert (np.sign(rightward) == (inward if bright else -inward)).all()


@pytest.mark.parametrize("degrees", [0, 22.5, 45, 90, 113])
def test_thresholds_come_from_the_picture(degrees: float) -> None:
    # The same bar at a tenth of the contrast gives the same edges, a little less exact: its
    # grey values are whole numbers.
    bar = Bar(angle=math.radians(degrees))
    clear = segments_of(bar.image(180.0, 70.0))
    hazy = segments_of(bar.image(131.0, 120.0))
    for segments in (clear, hazy):
        off, sides = off_edges(segments, bar)
        assert off.max() < 0.5
        for side in (-1, 1):
            found = lengths(segments[sides[:, 0] == side]).sum()
            assert found > 0.85 * bar.visible_length(side)


@pytest.mark.parametrize("contrast", [1.0, 0.3])
def test_grain_between_strong_edges_is_none_at_any_contrast(contrast: float) -> None:
    # Stripes of 60 px at 0.3 rad with grain: the edges alone are among the strongest.
    ys, xs = np.mgrid[0:240, 0:320].astype(np.float64)
    phase = 2.0 * math.pi / 60.0 * (ys * math.cos(0.3) - xs * math.sin(0.3))
    grain = np.random.default_rng(1).normal(0.0, 14.0, xs.shape)
    grey = 125.0 + contrast * (60.0 * np.tanh(10.0 * np.sin(phase)) + grain)
    segments = segments_of(np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8))
    step = (segments[:, 2:] - segments[:, :2]).astype(np.float64)
    along = np.abs(step @ [-math.sin(0.3), math.cos(0.3)]) < 0.1 * lengths(segments)
    assert lengths(segments[along]).sum() > 0.99 * lengths(segments).sum() > 2000.0


def test_a_corner_splits_a_broken_line() -> None:
    image = np.full((120, 160), 60, np.uint8)
    image[30:90, 40:120] = 190
    segments = segments_of(image)
    assert len(segments) >= 4
    # Everything found lies on one of the four sides of the rectangle.
    x, y = segments[:, [0, 2]].astype(np.float64), segments[:, [1, 3]].astype(np.float64)
    upright = [np.abs(x - edge).max(axis=1) < 0.5 for edge in (39.5, 119.5)]
    level = [np.abs(y - edge).max(axis=1) < 0.5 for edge in (29.5, 89.5)]
    sides = upright + level
    # Of each side all but the rounded corners.
    for mask, length in zip(sides, (60.0, 60.0, 80.0, 80.0), strict=True):
        assert lengths(segments[mask]).sum() > length - 16.0
    on_sides = np.any(sides, axis=0)
    assert lengths(segments[~on_sides]).sum() < 0.1 * lengths(segments).sum()


def test_a_circle_becomes_chords_within_the_tolerance() -> None:
    ys, xs = np.mgrid[0:200, 0:200]
    inside = np.clip(70.0 - np.hypot(xs - 99.5, ys - 99.5) + 0.5, 0.0, 1.0)
    segments = segments_of(np.asarray(np.rint(60.0 + 120.0 * inside), np.uint8))
    ends = segments.astype(np.float64).reshape(-1, 2, 2)
    middles = ends.mean(axis=1)
    # No place of a chord is off the circle by more than the tolerance of the split and its own
    # residual.
    for points in (ends[:, 0], ends[:, 1], middles):
        off = np.hypot(*(points - 99.5).T) - 70.0
        assert np.abs(off).max() < 1.5
    assert lengths(segments).sum() > 0.85 * 2.0 * math.pi * 70.0


def test_short_segments_are_dropped() -> None:
    image = np.full((80, 80), 60, np.uint8)
    image[40:48, 40:48] = 200
    assert len(segments_of(image)) == 0
    assert len(extract_segments(image, 1.2, 4.0)) > 0
    long = segments_of(Bar(angle=0.3).image())
    assert lengths(long).min() >= 12.0


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_constant_image_has_no_edges(value: int) -> None:
    assert segments_of(np.full((60, 80), value, np.uint8)).shape == (0, 4)


def test_the_noise_of_a_camera_is_no_edge() -> None:
    random = np.random.default_rng(2)
    image = np.asarray(np.rint(random.normal(100.0, 0.7, (120, 160))), np.uint8)
    assert len(segments_of(image)) == 0


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (5, 5), (4, 300), (300, 4)])
def test_tiny_images_are_taken(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
    segments = segments_of(image)
    assert segments.shape[1] == 4
    assert segments.dtype == np.float32
    assert np.isfinite(segments).all()


def test_more_segments_than_the_first_room_holds() -> None:
    # A board of 28 px squares: over a thousand sides.
    ys, xs = np.mgrid[0:1000, 0:1000]
    board = np.where(((xs // 28) + (ys // 28)) % 2 == 0, 60, 190).astype(np.uint8)
    segments = segments_of(board)
    assert len(segments) > 1024
    on_lattice = np.abs((segments.astype(np.float64) + 0.5 + 14.0) % 28.0 - 14.0) < 0.5
    upright = on_lattice[:, 0] & on_lattice[:, 2]
    level = on_lattice[:, 1] & on_lattice[:, 3]
    assert lengths(segments[upright | level]).sum() > 0.9 * lengths(segments).sum()


def test_shrinking_averages_and_keeps_places() -> None:
    image = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
    small = shrink(image, 2)
    assert small.shape == (3, 4)
    assert small[1, 2] == round(float(image[2:4, 4:6].mean()))
    assert shrink(image, 1) is image
    # The middle of the four pixels 4, 5 by 2, 3 is at (4.5, 2.5).
    there = to_full_size(np.array([[2.0, 1.0]], np.float32), 2)
    assert there.dtype == np.float32
    assert there.tolist() == [[4.5, 2.5]]


def test_an_edge_found_in_a_shrunk_image_is_at_its_place_in_the_full_one() -> None:
    bar = Bar(width=480, height=360, angle=0.4, thickness=90.0, offset=3.3)
    small = segments_of(shrink(bar.image(), 2))
    off, _ = off_edges(to_full_size(small, 2), bar)
    assert off.max() < 0.3


def test_a_pyramid_halves_three_times() -> None:
    image = np.random.default_rng(5).integers(0, 256, (45, 67)).astype(np.uint8)
    levels = pyramid(image)
    assert [level.shape for level in levels] == [(45, 67), (22, 33), (11, 16), (5, 8)]
    blocks = image[:40, :64].reshape(5, 8, 8, 8).mean(axis=(1, 3))
    # Rounded three times.
    assert np.abs(levels[3] - blocks).max() < 1.0
    assert [level.shape for level in pyramid(image[:3, :3])][1:] == [(1, 1), (0, 0), (0, 0)]
