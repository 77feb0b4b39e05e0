"""The error of exports."""

from __future__ import annotations

from pipeline_tracker.errors import PipelineTrackerError


class ExportError(PipelineTrackerError):
    """Results cannot be exported as asked."""
