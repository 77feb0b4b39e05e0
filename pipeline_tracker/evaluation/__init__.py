"""Figures: a replay measured against the truth of a bag."""

from pipeline_tracker.evaluation.command import FILE_NAME, evaluate, evaluate_command
from pipeline_tracker.evaluation.schema import Evaluation, evaluation_schema

__all__ = ["FILE_NAME", "Evaluation", "evaluate", "evaluate_command", "evaluation_schema"]
