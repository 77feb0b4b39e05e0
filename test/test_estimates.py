"""Rows of estimates.csv."""

from __future__ import annotations

import numpy as np

from pipeline_tracker.replay.estimates import estimate_row
from pipeline_tracker.types import Mode, PipeSegment, RelativeState, State, TrackingStatus


def test_a_coasting_row_is_filled_and_not_valid() -> None:
    segment = PipeSegment(
        7, Mode.TRACKING, 0, np.array([1.0, 0.0, -2.0]), np.array([1.5, 0.0, -2.0]), 0.3,
        np.eye(4), 0.0,
    )  # fmt: skip
    status = TrackingStatus(7, State.COASTING, "surface_not_a_pipe", 0.0, 2.0, 0)
    state = RelativeState(7, False, 0.0, 0, min_distance=1.7, heading_variance=0.01, chainage=3.0)
    bed = (0.31, None)
    row = estimate_row(status, segment, state, has_pose=True, processing_ms=1.0, bed=bed)
    assert row["state"] == "coasting"
    assert row["valid"] == "0"
    assert float(row["start_x"]) == 1.0
    assert float(row["end_x"]) == 1.5
    assert float(row["min_distance"]) == 1.7
    assert float(row["chainage"]) == 3.0
    assert row["bed_left"] == "0.310000000"
    assert "bed_right" not in row


def test_a_searching_row_has_no_numbers() -> None:
    status = TrackingStatus(7, State.SEARCHING, "pipe_not_found", 0.0, -1.0, 0)
    row = estimate_row(
        status, None, RelativeState(7, False, 0.0, 0), has_pose=True, processing_ms=1
    )
    assert set(row) == {"stamp_ns", "state", "valid", "reason", "side", "processing_ms"}
    assert row["side"] == "not_in_view"
