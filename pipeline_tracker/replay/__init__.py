"""A recorded bag through the whole pipeline, offline."""

from pipeline_tracker.replay.resumption import earlier_settings
from pipeline_tracker.replay.runner import ReplayOutcome, default_output, replay

__all__ = ["ReplayOutcome", "default_output", "earlier_settings", "replay"]
