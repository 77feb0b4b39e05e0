"""Scenes with truth.

The names below are imported on first use, so that importing the package asks for neither the ray
tracer nor its extra.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline_tracker.simulation.scenario_files import list_scenarios, load_scenario
    from pipeline_tracker.simulation.simulator import simulate

__all__ = ["list_scenarios", "load_scenario", "simulate"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        module = "simulator" if name == "simulate" else "scenario_files"
        return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
