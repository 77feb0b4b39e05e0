"""Many seas, replays and figures from one manifest, on one machine or many.

The names below are imported on first use: a worker needs a part of the package only.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline_tracker.benchmark.command import benchmark_command
    from pipeline_tracker.benchmark.manifest import Manifest, read_manifest
    from pipeline_tracker.benchmark.plan import Plan, make_plan

_PLACES = {
    "Manifest": "manifest",
    "Plan": "plan",
    "benchmark_command": "command",
    "make_plan": "plan",
    "read_manifest": "manifest",
}

__all__ = ["Manifest", "Plan", "benchmark_command", "make_plan", "read_manifest"]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
