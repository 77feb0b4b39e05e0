"""Matches of textured pairs whose disparity is known below a pixel."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pictures import stereo_pair

from pipeline_tracker.vectorization.coarse_disparity import (
    _heights,
    coarse_disparities,
    coarse_side,
    grid_sides,
    raised_points,
    sparse_points,
)
from pipeline_tracker.vectorization.correlation import HALF, correlations
from pipeline_tracker.vectorization.patch_alignment import (
    _right_sums,
    align_patch,
    make_patch,
    smoothed,
)
from pipeline_tracker.vectorization.segments import pyramid
from pipeline_tracker.vectorization.stereo_matching import (
    _PATCH,
    StereoLevels,
    _half_disparities,
    _match,
    match_pair,
    segment_points,
    stereo_levels,
)

Image = NDArray[np.uint8]


def levels_of(left: Image, right: Image) -> StereoLevels:
    return stereo_levels(pyramid(left), pyramid(right))


def grid_points(width: int, height: int, spacing: int) -> NDArray[np.int64]:
    columns, rows = np.meshgrid(*grid_sides(width, height, spacing))
    return np.stack((columns.ravel(), rows.ravel()), axis=1)


def match_points(levels: StereoLevels, points: NDArray[np.int64]) -> NDArray[np.float32]:
    return _match(levels, _PATCH, points, _half_disparities(levels, points))


def matches_of(left: Image, right: Image, spacing: int = 16) -> NDArray[np.float64]:
    points = grid_points(left.shape[1], left.shape[0], spacing)
    return match_points(levels_of(left, right), points).astype(np.float64)


@pytest.mark.parametrize("disparity", [0.0, 0.3, 3.5, 17.25, 42.7, 80.5, 95.9])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(disparity: float) -> None:
    left, right = stereo_pair(disparity)
    found = matches_of(left, right)
    errors = found[:, 0] - found[:, 2] - disparity
    assert np.median(np.abs(errors)) < 0.1
    assert np.mean(np.abs(errors) < 0.5) > 0.97
    assert (found[:, 1] == found[:, 3]).all()
    # Nearly every point whose partner is inside the right picture is matched.
    points = grid_points(400, 160, 16)
    room = (points[:, 0] - disparity > 18) & (points[:, 0] < 380)
    room &= (points[:, 1] > 18) & (points[:, 1] < 142)
    assert len(found) > 0.9 * room.sum()


@pytest.mark.parametrize("slope", [0.05, -0.05])
def test_a_slanted_plane_is_followed(slope: float) -> None:
    left, right = stereo_pair(30.0, slope=slope)
    found = matches_of(left, right)
    errors = found[:, 0] - found[:, 2] - (30.0 + slope * found[:, 0])
    assert np.median(np.abs(errors)) < 0.1
    assert np.mean(np.abs(errors) < 0.6) > 0.95


def test_other_light_in_one_camera_does_not_matter() -> None:
    left, right = stereo_pair(25.4)
    darker = np.asarray(np.rint(20.0 + 0.5 * right), np.uint8)
    found = matches_of(left, darker)
    assert len(found) > 100
    assert np.median(np.abs(found[:, 0] - found[:, 2] - 25.4)) < 0.1


def test_noise_costs_little() -> None:
    random = np.random.default_rng(1)
    left, right = (
        np.asarray(np.clip(np.rint(image + random.normal(0.0, 4.0, image.shape)), 0, 255), np.uint8)
        for image in stereo_pair(25.4)
    )
    found = matches_of(left, right)
    assert len(found) > 100
    assert np.median(np.abs(found[:, 0] - found[:, 2] - 25.4)) < 0.1


def test_constant_images_give_no_matches() -> None:
    left, right = stereo_pair(20.0)
    flat = np.full_like(left, 120)
    for pair in ((flat, flat), (left, flat), (flat, right)):
        assert matches_of(*pair).shape == (0, 4)


def test_different_textures_hardly_match() -> None:
    left, _ = stereo_pair(20.0, seed=1)
    _, right = stereo_pair(20.0, seed=2)
    assert len(matches_of(left, right)) < 0.1 * len(grid_points(400, 160, 16))


def test_all_places_are_inside_both_pictures() -> None:
    left, right = stereo_pair(90.0)
    ys, xs = np.mgrid[-20:180:3, -20:420:3]
    everywhere = np.stack((xs.ravel(), ys.ravel()), axis=1).astype(np.int64)
    found = match_points(levels_of(left, right), everywhere)
    assert found.dtype == np.float32
    assert len(found) > 1000
    for column, size in ((0, 400), (1, 160), (2, 400), (3, 160)):
        assert found[:, column].min() >= 0
        assert found[:, column].max() <= size - 1


@pytest.mark.parametrize("shape", [(1, 1), (5, 40), (16, 16), (40, 5), (30, 60)])
def test_tiny_images_are_taken(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    left, right = (random.integers(0, 255, shape).astype(np.uint8) for _ in range(2))
    ys, xs = np.mgrid[0 : shape[0], 0 : shape[1]]
    points = np.stack((xs.ravel(), ys.ravel()), axis=1).astype(np.int64)
    found = match_points(levels_of(left, right), points)
    assert found.shape[1] == 4
    assert match_pair(pyramid(left), pyramid(right), np.zeros((0, 4), np.float32), 6).shape[1] == 4
    assert np.isfinite(found).all()


def test_correlations_are_those_of_numpy() -> None:
    random = np.random.default_rng(4)
    left, right = (random.integers(0, 256, (30, 60)).astype(np.uint8) for _ in range(2))
    columns = np.arange(-HALF, HALF + 1)
    rows = columns[:, None]
    for xl, yl, xr, yr in ((5, 5, 6, 5), (20, 15, 30, 11), (54, 24, 53, 24)):
        a = left[yl + rows, xl + columns].ravel().astype(float)
        for i, found in enumerate(correlations(left, right, xl, yl, xr, yr)):
            b = right[yr + rows, xr - 1 + i + columns].ravel().astype(float)
            assert found == pytest.approx(float(np.corrcoef(a, b)[0, 1]), abs=1e-12)
    assert correlations(left, left, 12, 9, 12, 9)[1] == pytest.approx(1.0)
    assert correlations(left, 255 - left, 12, 9, 12, 9)[1] == pytest.approx(-1.0)
    assert correlations(left, np.full_like(left, 9), 12, 9, 12, 9) == (-1.0, -1.0, -1.0)


def test_the_grid_is_fixed_and_centred() -> None:
    points = grid_points(100, 70, 30)
    assert points.dtype == np.int64
    assert np.unique(points[:, 0]).tolist() == [20, 50, 80]
    assert np.unique(points[:, 1]).tolist() == [20, 50]
    assert len(points) == 6


def test_points_go_along_segments_that_do_not_follow_a_row() -> None:
    segments = np.array(
        [
            [10, 10, 10, 110],  # up the picture
            [50, 50, 150, 60],  # along a row
            [200, 10, 200, 40],  # short
        ],
        np.float32,
    )
    points = segment_points(segments, 20)
    assert points.tolist() == [[10, 20], [10, 40], [10, 60], [10, 80], [10, 100]]
    assert segment_points(segments[1:], 20).shape == (0, 2)
    assert segment_points(segments[:0], 20).shape == (0, 2)


def wave(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey levels of a texture that is known between the pixels too."""
    waves = ((0.61, 0.23, 0.4), (0.34, -0.52, 1.9), (0.83, 0.1, 4.0), (0.15, 0.7, 2.2))
    return 120.0 + sum(18.0 * np.sin(a * x + b * y + c) for a, b, c in waves)


def sixteenfold(levels: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.asarray(np.rint(16.0 * levels), np.uint16)


@pytest.mark.parametrize("slant", [(0.0, 0.0), (0.15, 0.0), (-0.2, 0.1), (0.05, -0.25)])
@pytest.mark.parametrize("start", [-0.9, 0.0, 0.7])
def test_a_slanted_patch_is_aligned_to_hundredths(slant: tuple[float, float], start: float) -> None:
    ys, xs = np.mgrid[0:60, 0:120].astype(np.float64)
    x, y, disparity = 70, 30, 21.37
    # right(u) = left(x) where u = x - d(x, y); d is a plane through the patch's middle.
    a, b = slant
    source = (xs + disparity - a * x + b * (ys - y)) / (1.0 - a)
    left = sixteenfold(wave(xs, ys))
    right = sixteenfold(0.7 * wave(source, ys) + 20.0)
    found, quality = align_patch(left, right, make_patch(), x, y, disparity + start)
    assert found == pytest.approx(disparity, abs=0.03)
    assert quality > 0.995


def test_patches_are_aligned_up_to_the_sides_of_the_right_image() -> None:
    ys, xs = np.mgrid[0:60, 0:120].astype(np.float64)
    left, right = sixteenfold(wave(xs, ys)), sixteenfold(wave(xs + 40.25, ys))
    for x in (55, 60, 108):
        found, quality = align_patch(left, right, make_patch(), x, 30, 40.0)
        assert found == pytest.approx(40.25, abs=0.03)
        assert quality > 0.995
    right = sixteenfold(wave(xs + 1.25, ys))
    assert align_patch(left, right, make_patch(), 107, 30, 1.0)[0] == pytest.approx(1.25, abs=0.03)
    assert align_patch(left[:, :50], right[:, :50], make_patch(), 25, 30, 1.0)[1] == -1.0


def test_sums_of_a_patch_are_those_of_a_slow_reference() -> None:
    random = np.random.default_rng(8)
    patch = make_patch()
    window = random.normal(0.0, 300.0, 11 * 56).astype(np.float32)
    level, slope = (random.normal(0.0, 300.0, 220).astype(np.float32) for _ in range(2))
    place, slant_x, slant_y = np.float32(26.3), np.float32(0.2), np.float32(-0.15)
    sums = np.zeros(6)
    for j in range(11):
        for i in range(20):
            n, across, down = 20 * j + i, i - 9, 2 * j - 10
            exact = place + (1.0 - slant_x) * across - slant_y * down
            whole = int(exact)
            near = window[56 * j + whole - 1 : 56 * j + whole + 3].astype(np.float64)
            value = catmull_rom(near, exact - whole)
            terms = (1.0, value, level[n], slope[n], slope[n] * across, slope[n] * down)
            sums += patch.weight[n] * value * np.array(terms)
    found = _right_sums(window, place, slant_x, slant_y, patch, level, slope)
    assert np.allclose(found, sums, rtol=1e-4, atol=1e-4 * np.abs(sums).max())


def catmull_rom(p: NDArray[np.float64], f: float) -> float:
    """Cubic between the second and the third of four values, with half their outer differences."""
    basis = [[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]
    return float(0.5 * np.array([1.0, f, f * f, f**3]) @ np.array(basis) @ p)


def test_a_patch_that_shows_nothing_is_refused() -> None:
    flat = np.full((60, 120), 16 * 90, np.uint16)
    ys, xs = np.mgrid[0:60, 0:120].astype(np.float64)
    textured = sixteenfold(wave(xs, ys))
    for pair in ((flat, flat), (flat, textured), (textured, flat)):
        assert align_patch(*pair, make_patch(), 70, 30, 20.0)[1] == -1.0
    # At the border, and where its partner is outside.
    for x, y, disparity in ((5, 30, 0.0), (70, 4, 0.0), (30, 30, 25.0), (118, 30, 0.0)):
        assert align_patch(textured, textured, make_patch(), x, y, disparity)[1] == -1.0


@pytest.mark.parametrize("shape", [(40, 50), (1, 1), (1, 30), (2, 3)])
def test_smoothing_is_that_of_a_slow_reference(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(2).integers(0, 256, shape).astype(np.uint8)
    image[0, 0] = 255
    smooth = np.zeros(shape, np.uint16)
    smoothed(image, smooth)
    padded = np.pad(image.astype(np.int64), 1, mode="edge")
    rows = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    assert (smooth == rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:]).all()


def test_coarse_disparities_reach_the_left_border() -> None:
    left, right = stereo_pair(32.0)
    found = coarse_disparities(left, right)
    assert found.shape == left.shape
    # Left of the disparity there is no partner.
    inside = found[12:-12, 48:-12]
    assert np.nanmedian(inside) == pytest.approx(32.0, abs=0.5)
    assert np.mean(np.abs(inside - 32.0) < 1.0) > 0.9


def test_coarse_pixels_are_larger_in_larger_images() -> None:
    assert [coarse_side(width) for width in (1, 400, 401, 800, 1200, 1600)] == [2, 2, 4, 4, 8, 8]


def test_points_are_dense_where_the_surface_stands_out() -> None:
    columns, rows = grid_sides(600, 400, 7)
    sparse = sparse_points(columns, rows)
    x, y = sparse[:, 0], sparse[:, 1]
    bump = np.abs(x - 360) < 60
    disparities = (40.0 + 0.01 * x - 0.02 * y + 5.0 * bump).astype(np.float32)
    disparities[::17] = np.nan
    disparities[5::31] += 30.0
    points = raised_points(columns, rows, disparities)
    raised = np.abs(points[:, 0] - 360) < 50
    fine = grid_points(600, 400, 7)
    there = np.abs(fine[:, 0] - 360) < 50
    # All but the sparse ones, one in nine.
    assert raised.sum() > 0.85 * there.sum() * 8 / 9
    assert (~raised).sum() < 0.3 * len(fine)
    # The grid is fixed: no point lies between its nodes, and none comes twice.
    nodes = {tuple(p) for p in fine.tolist()}
    chosen = [tuple(p) for p in np.concatenate((points, sparse)).tolist()]
    assert len(set(chosen)) == len(chosen)
    assert set(chosen) <= nodes


def slow_heights(disparities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robust plane by least squares again and again, then the mean of what is known about each."""
    ys, xs = np.nonzero(np.isfinite(disparities))
    values = disparities[ys, xs]
    design = np.column_stack((np.ones(len(xs)), xs, ys))
    off, spread = np.zeros(len(xs)), 1.0
    plane = np.zeros(3)
    for _ in range(5):
        root = 1.0 / np.sqrt(1.0 + np.square(off / spread))
        plane = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        off = np.abs(values - design @ plane)
        spread = max(1.4826 * float(np.median(off)), 0.05)
    away = np.full(disparities.shape, np.nan)
    away[ys, xs] = np.clip(values - design @ plane, -8.0 * spread, 8.0 * spread)
    heights = np.full(disparities.shape, np.nan)
    for place in np.ndindex(disparities.shape):
        near = away[tuple(slice(max(k - 1, 0), k + 2) for k in place)]
        if np.mean(np.isfinite(near)) >= 0.3:
            heights[place] = np.nanmean(near)
    return heights


@pytest.mark.parametrize("unknown", [0.0, 0.3, 0.7])
def test_heights_over_the_bed_are_those_of_a_slow_reference(unknown: float) -> None:
    random = np.random.default_rng(5)
    ys, xs = np.mgrid[0:17, 0:23]
    disparities = 30.0 + 0.4 * ys - 0.2 * xs + random.normal(0.0, 0.2, ys.shape)
    disparities[:, 9:12] += 4.0
    disparities[random.random(ys.shape) < 0.05] += 40.0
    disparities[random.random(ys.shape) < unknown] = np.nan
    assert np.allclose(_heights(disparities), slow_heights(disparities), atol=1e-6, equal_nan=True)


def test_without_disparities_the_sparse_grid_is_left() -> None:
    columns, rows = grid_sides(600, 400, 14)
    sparse = sparse_points(columns, rows)
    fine = len(grid_points(600, 400, 14))
    assert 0.07 * fine < len(sparse) < 0.15 * fine
    nothing = np.full(len(sparse), np.nan)
    assert len(raised_points(columns, rows, nothing)) == 0
    nothing[7] = 3.0
    assert len(raised_points(columns, rows, nothing)) == 0
    # Nor where the image is too small for a grid.
    columns, rows = grid_sides(12, 9, 14)
    assert len(raised_points(columns, rows, np.zeros(len(sparse_points(columns, rows))))) == 0


def test_matches_by_chance_are_none() -> None:
    # Rows farther off than is looked for: some patches match all the same, at any disparity.
    left, right = stereo_pair(25.4)
    shifted = np.roll(right, 25, axis=0)
    segments = np.zeros((0, 4), np.float32)
    assert len(match_pair(pyramid(left), pyramid(right), segments, 6)) > 200
    assert len(match_pair(pyramid(left), pyramid(shifted), segments, 6)) == 0
