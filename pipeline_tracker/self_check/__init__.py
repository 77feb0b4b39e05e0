"""The user's own numbers against what the pictures show, while running."""

from pipeline_tracker.self_check.check import SelfCheck

__all__ = ["SelfCheck"]
