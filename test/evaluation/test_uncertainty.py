"""Errors in units of their covariance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.evaluation.uncertainty import LEVELS, chi2_quantile, segment_offsets, weigh


@pytest.mark.parametrize("level", LEVELS)
def test_regions_are_those_of_a_two_dimensional_normal(level: float) -> None:
    assert chi2_quantile(level / 100.0) == pytest.approx(chi2.ppf(level / 100.0, 2))


def test_offsets_have_the_signs_of_the_covariance() -> None:
    start, end = np.array([0.0, 0.02, 0.01]), np.array([1.0, 0.04, 0.03])
    line = np.array([1.0, 0.0, 0.0])
    foot = np.array([0.5, 0.0, 0.0])
    offsets = segment_offsets(start, end, foot, line)
    assert offsets is not None
    # To the left, above, turned to the left, climbing; whichever way the axis is listed.
    assert offsets == pytest.approx([0.03, 0.02, 0.02, 0.02], abs=1e-3)
    again = segment_offsets(start, end, foot, -line)
    assert again is not None
    np.testing.assert_allclose(again, offsets)
    assert segment_offsets(np.zeros(3), np.array([0.0, 0.0, 1.0]), foot, line) is None


def test_a_covariance_that_is_none_weighs_nothing() -> None:
    offsets = np.array([0.01, 0.0, 0.02, 0.0])
    covariance = np.diag([1e-4, 1e-4, 4e-4, 1e-4])
    weighed = weigh(offsets, covariance)
    assert weighed is not None
    assert weighed.nees == pytest.approx(1.0)
    assert weighed.direction_nees == pytest.approx(1.0)
    assert weighed.sigmas == pytest.approx([0.01, 0.01, 0.02, 0.01])
    assert weigh(offsets, np.diag([0.0, 1e-4, 1e-4, 1e-4])) is None
    assert weigh(offsets, np.full((4, 4), np.nan)) is None
    covariance[0, 1] = covariance[1, 0] = 1e-4
    degenerate = weigh(offsets, covariance)
    assert degenerate is not None
    assert degenerate.nees is None


def test_a_right_covariance_has_its_shares_and_a_mean_of_2(make_sea: Any, tmp_path: Path) -> None:
    # 1 cm of error across and upwards, as the covariance says.
    sea = make_sea(count=60)
    x = np.arange(-2.0, 20.0, 0.05)
    sea.centerline = np.stack((x, np.full_like(x, 0.1), np.full_like(x, 0.2)), axis=1)
    rng = np.random.default_rng(5)
    frames = [f.moved([0.0, *rng.normal(0.0, 0.01, 2)]) for f in sea.frames()]
    result = evaluate(
        sea.write_replay(tmp_path / "replay", frames), sea.write_truth(tmp_path / "truth")
    )
    coverage = result.groups["all"].coverage_95
    assert coverage.frames == 60
    nees = [f.nees for f in result.per_frame]
    assert coverage.nees_mean == pytest.approx(np.mean(nees))
    assert coverage.nees_mean == pytest.approx(2.0, abs=4.0 * 2.0 / math.sqrt(60.0))
    for level, share in coverage.levels.items():
        expected = float(level) / 100.0
        assert share == pytest.approx(expected, abs=3.5 * math.sqrt(expected / 4.0 / 60.0))
    assert coverage.share == coverage.levels["95"] == np.mean([f.covered for f in result.per_frame])
    # The segments are only moved: their direction is without error.
    assert result.groups["all"].direction_coverage_95.nees_mean == pytest.approx(0.0, abs=1e-12)


def test_errors_are_set_beside_the_sigmas_of_the_relative_state(sea: Any, tmp_path: Path) -> None:
    frames = [
        f.moved(np.array([0.0, 0.0, 0.03 if i < 6 else 0.0])) for i, f in enumerate(sea.frames())
    ]
    result = evaluate(
        sea.write_replay(tmp_path / "replay", frames), sea.write_truth(tmp_path / "truth")
    )
    errors = result.groups["all"].errors
    assert errors["lateral_offset"].in_95 is None
    # 3 cm of distance are more than 1.96 times 1 cm.
    assert errors["min_distance"].in_95 == 0.5
    assert result.per_frame[0].error_sigmas["min_distance"] == pytest.approx(0.01, rel=0.1)
