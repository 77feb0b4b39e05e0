"""A small sea, built once."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea

# A coarse bed and small images: the same code in a fraction of the time.
SMALL = (
    "camera.width=192",
    "camera.height=128",
    "bed.resolution=0.06",
    "bed.stones=0.3",
    "frames=2",
)


@pytest.fixture(scope="session")
def small() -> Callable[..., Scenario]:
    """Return a function that loads the demo made small, with further overrides."""

    def load(*overrides: str, seed: int | None = None) -> Scenario:
        return load_scenario("demo", [*SMALL, *overrides], seed)

    return load


@pytest.fixture(scope="session")
def sea(small: Callable[..., Scenario]) -> Sea:
    return build_sea(small())
