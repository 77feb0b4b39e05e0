"""Figures: a replay measured against the truth of a bag."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pipeline_tracker.evaluation.schema import Evaluation, evaluation_schema

if TYPE_CHECKING:
    from pipeline_tracker.evaluation.command import FILE_NAME, evaluate, evaluate_command

__all__ = ["FILE_NAME", "Evaluation", "evaluate", "evaluate_command", "evaluation_schema"]


def __getattr__(name: str) -> Any:
    """Import what measures and plots where it is used: each replay reads the schema alone."""
    if name not in __all__:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    from pipeline_tracker.evaluation import command  # noqa: PLC0415

    return getattr(command, name)
