"""Rows of a pair that do not agree: measured, and matched all the same."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pictures import stereo_pair

from pipeline_tracker.vectorization.segments import pyramid
from pipeline_tracker.vectorization.stereo_matching import match_pair

Image = NDArray[np.uint8]
NO_SEGMENTS = np.zeros((0, 4), np.float32)


def matched(left: Image, right: Image) -> NDArray[np.float64]:
    return match_pair(pyramid(left), pyramid(right), NO_SEGMENTS, 20).astype(np.float64)


@pytest.mark.parametrize("rows", [-3, -2, -1, 0, 1, 2, 3])
def test_rows_apart_are_measured_and_matched(rows: int) -> None:
    left, right = stereo_pair(disparity=21.3, width=800, height=400)
    right = np.roll(right, rows, axis=0)
    matches = matched(left, right)
    straight = matched(left, np.roll(right, -rows, axis=0))
    assert len(matches) > 0.85 * len(straight)
    assert np.median(matches[:, 3] - matches[:, 1]) == pytest.approx(rows, abs=0.2)
    assert np.median(matches[:, 0] - matches[:, 2]) == pytest.approx(21.3, abs=0.05)


def test_half_a_row() -> None:
    left, right = stereo_pair(disparity=21.3, width=800, height=401)
    right = (0.5 * right[:-1] + 0.5 * right[1:]).astype(np.uint8)
    matches = matched(left[:-1], right)
    assert np.median(matches[:, 3] - matches[:, 1]) == pytest.approx(-0.5, abs=0.12)
