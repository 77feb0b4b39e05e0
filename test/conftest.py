"""Settings of the whole test run."""

from __future__ import annotations

import os
from importlib.util import find_spec

import pytest
from hypothesis import settings

# A busy machine is slow, not wrong. The same examples in each run: a test that passed passes again;
# PIPELINE_TRACKER_SEARCH=1 looks for new ones.
settings.register_profile(
    "pipeline_tracker", deadline=None, derandomize="PIPELINE_TRACKER_SEARCH" not in os.environ
)
settings.load_profile("pipeline_tracker")

# Tests talk over DDS and must not reach other machines; set before anything starts rclpy.
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def _missing_for_ros() -> list[str]:
    # The definitions' directory has the name of the compiled package, but no origin.
    wanted = {name: find_spec(name) for name in ("rclpy", "pipeline_tracker_msgs")}
    return [name for name, spec in wanted.items() if spec is None or spec.origin is None]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests marked ``ros`` where ROS is missing, and say what is missing."""
    missing = _missing_for_ros()
    if missing:
        skip = pytest.mark.skip(reason=f"ROS 2 is not installed: no {' and no '.join(missing)}")
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(skip)
