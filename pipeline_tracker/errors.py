"""Errors that are meant for the user."""

from __future__ import annotations


class PipelineTrackerError(Exception):
    """Something a user can put right; its text is the one line that they read.

    The text says what is wrong, which value, what was expected and what to do.
    Commands print it on stderr and end with exit code 2.
    """


class SettingsError(PipelineTrackerError):
    """A setting is unknown, missing or out of its range."""


class BagError(PipelineTrackerError):
    """A bag cannot be read or written, or lacks something that was asked of it."""


class CalibrationError(PipelineTrackerError):
    """Camera calibration or mounting is missing or impossible."""


class MessageError(PipelineTrackerError):
    """A message cannot be used.

    Attributes:
        field: which one is at fault; empty where it is the whole message.
    """

    def __init__(self, text: str, field: str = "") -> None:
        """Say what is wrong, and in which field."""
        super().__init__(text)
        self.field = field


class ImageError(MessageError):
    """An image cannot be used; its text is the reason that the frame is lost."""


class EvaluationError(PipelineTrackerError):
    """A replay cannot be measured against a truth, or the two do not belong together."""


class ManifestError(PipelineTrackerError):
    """A benchmark's manifest is wrong, or its directory cannot be used."""


class BenchError(PipelineTrackerError):
    """Speed cannot be measured as asked."""
