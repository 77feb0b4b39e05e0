"""Segment and motion to what the autopilot needs (4.3)."""

from pipeline_tracker.relative_state.estimator import RelativeStateEstimator
from pipeline_tracker.relative_state.side import side_from_contours

__all__ = ["RelativeStateEstimator", "side_from_contours"]
