"""Gradient, suppression and thresholds against slow plain references."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.vectorization.edges import (
    NO_EDGE,
    STRONG,
    WEAK,
    gradient_magnitude,
    magnitude_quantile,
    ridge_offset,
    suppress_non_maxima,
)


def derivatives(seed: int, size: int = 400) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    random = np.random.default_rng(seed)
    dx = random.integers(-size, size + 1, (24, 31)).astype(np.int16)
    dy = random.integers(-size, size + 1, (24, 31)).astype(np.int16)
    dx[5, :8] = 0
    dy[9, :8] = 0
    return dx, dy


def magnitude_of(dx: NDArray[np.int16], dy: NDArray[np.int16]) -> NDArray[np.float32]:
    # What was left in the arrays before must not matter.
    magnitude = np.full(dx.shape, np.nan, np.float32)
    gradient_magnitude(dx, dy, magnitude)
    return magnitude


def ridge_of(
    dx: NDArray[np.int16],
    dy: NDArray[np.int16],
    magnitude: NDArray[np.float32],
    low: float,
    high: float,
) -> NDArray[np.uint8]:
    ridge = np.full(dx.shape, 7, np.uint8)
    suppress_non_maxima(dx, dy, magnitude, low, high, ridge)
    return ridge


def offset_at(
    dx: NDArray[np.int16], dy: NDArray[np.int16], magnitude: NDArray[np.float32], y: int, x: int
) -> float:
    width = dx.shape[1]
    return float(ridge_offset(dx.ravel(), dy.ravel(), magnitude.ravel(), y * width + x, width))


def test_the_magnitude_is_the_root_of_both_squares() -> None:
    dx, dy = derivatives(1)
    # The largest values that a Sobel operator gives; their squares do not fit into int16.
    dx[0, 0], dy[0, 0] = 1020, -1020
    expected = np.hypot(dx.astype(np.float64), dy.astype(np.float64))
    magnitude = magnitude_of(dx, dy)
    assert magnitude.dtype == np.float32
    assert np.allclose(magnitude, expected, rtol=1e-6)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.93])
@pytest.mark.parametrize("step", [1, 2])
def test_the_quantile_is_that_of_the_pixels_looked_at(share: float, step: int) -> None:
    random = np.random.default_rng(7)
    magnitude = random.gamma(2.0, 60.0, (120, 160)).astype(np.float32)
    exact = float(np.quantile(magnitude[::step, ::step], share))
    # By whole numbers, rounded down.
    assert exact - 1.5 <= magnitude_quantile(magnitude, share, step) <= exact + 0.5


def test_the_quantile_ends_at_its_last_bin() -> None:
    assert magnitude_quantile(np.full((8, 8), 5000.0, np.float32), 0.93, 1) == 2047.0
    assert magnitude_quantile(np.zeros((8, 8), np.float32), 0.93, 1) == 0.0


def test_the_quantile_is_not_above_all_magnitudes() -> None:
    # A picture of many edges, all alike.
    magnitude = np.zeros((40, 40), np.float32)
    magnitude[:, ::5] = 263.7
    assert magnitude_quantile(magnitude, 0.93, 1) <= 263.7


def interpolated(image: NDArray[np.float32], x: float, y: float) -> float:
    """Bilinear interpolation, one pixel after the other."""
    x0, y0 = math.floor(x), math.floor(y)
    u, v = x - x0, y - y0
    total = 0.0
    for i, wy in ((y0, 1.0 - v), (y0 + 1, v)):
        for j, wx in ((x0, 1.0 - u), (x0 + 1, u)):
            if wx * wy > 0.0:
                total += wx * wy * float(image[i, j])
    return total


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_suppression_agrees_with_a_slow_reference(seed: int) -> None:
    dx, dy = derivatives(seed)
    magnitude = magnitude_of(dx, dy)
    low, high = 150.0, 400.0
    ridge = ridge_of(dx, dy, magnitude, low, high)
    height, width = magnitude.shape
    kept = 0
    for y in range(height):
        for x in range(width):
            if not (2 <= y < height - 2 and 2 <= x < width - 2) or magnitude[y, x] < low:
                assert ridge[y, x] == NO_EDGE
                continue
            # One step along the gradient that ends between two pixels.
            largest = max(abs(float(dx[y, x])), abs(float(dy[y, x])))
            step = np.array([float(dx[y, x]), float(dy[y, x])]) / largest
            here = float(magnitude[y, x])
            ahead = interpolated(magnitude, x + step[0], y + step[1])
            behind = interpolated(magnitude, x - step[0], y - step[1])
            if min(abs(here - ahead), abs(here - behind)) < 1e-3:
                continue
            found = STRONG if here >= high else WEAK
            assert ridge[y, x] == (found if here > ahead and here > behind else NO_EDGE)
            if ridge[y, x]:
                kept += 1
                # Top of the parabola through three magnitudes, a step apart.
                top = np.polyfit([-1.0, 0.0, 1.0], [behind, here, ahead], 2)
                place = -top[1] / (2.0 * top[0]) * float(np.hypot(*step))
                offset = offset_at(dx, dy, magnitude, y, x)
                assert offset == pytest.approx(place, abs=1e-3)
    assert kept > 20


def test_a_plateau_keeps_one_pixel() -> None:
    # Two columns of the same magnitude, gradient to the right.
    dx = np.zeros((9, 12), np.int16)
    dx[:, 5:7] = 300
    dy = np.zeros_like(dx)
    magnitude = magnitude_of(dx, dy)
    ridge = ridge_of(dx, dy, magnitude, 100.0, 400.0)
    assert ridge[4].sum() == WEAK
    # The edge lies between the two, wherever it is kept.
    x = int(np.argmax(ridge[4]))
    assert x + offset_at(dx, dy, magnitude, 4, x) == pytest.approx(5.5)
