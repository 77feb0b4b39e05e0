"""The user's own numbers against what the pictures show, while running."""

from pipeline_tracker.self_check.check import SelfCheck
from pipeline_tracker.self_check.way import warm_up as warm_up_check

__all__ = ["SelfCheck", "warm_up_check"]
