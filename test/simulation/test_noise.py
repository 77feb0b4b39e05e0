from __future__ import annotations

import numpy as np
import pytest

from pipeline_tracker.simulation.noise import fractal_noise, gradient_noise, spots

PLACES = np.random.default_rng(4).uniform(-20, 20, (60, 2))


def test_derivatives_against_differences() -> None:
    h = 1e-5
    for x, y in PLACES:
        _, by_x, by_y = fractal_noise(x, y, 0.7, 4, 0.6, 1e-6, 0, 3)
        ahead, behind = (fractal_noise(x + d, y, 0.7, 4, 0.6, 1e-6, 0, 3)[0] for d in (h, -h))
        left, right = (fractal_noise(x, y + d, 0.7, 4, 0.6, 1e-6, 0, 3)[0] for d in (h, -h))
        assert by_x == pytest.approx((ahead - behind) / (2 * h), abs=1e-4)
        assert by_y == pytest.approx((left - right) / (2 * h), abs=1e-4)


def test_noise_closes_around_the_pipe() -> None:
    around = 1.885
    for x, y in PLACES:
        here = fractal_noise(x, y, around / 9, 4, 0.7, 1e-6, 9, 5)[0]
        assert fractal_noise(x, y + around, around / 9, 4, 0.7, 1e-6, 9, 5)[0] == pytest.approx(
            here, abs=1e-9
        )
        cell = around / 60
        assert (
            spots(x, y, cell, 0.5, 1e-6, 60, 5)[3]
            == spots(x, y + around, cell, 0.5, 1e-6, 60, 5)[3]
        )


def test_a_coarse_pixel_sees_no_fine_texture() -> None:
    values = [fractal_noise(x, y, 0.1, 6, 0.9, 0.06, 0, 1)[0] for x, y in PLACES]
    assert not np.any(values)


def test_other_seeds_give_other_noise() -> None:
    one, other = (
        np.array([gradient_noise(x, y, 0, seed)[0] for x, y in PLACES]) for seed in (1, 2)
    )
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.4
    assert 0.2 < one.std() < 0.45
