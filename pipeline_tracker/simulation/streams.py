"""Random numbers of a scenario: one stream for each purpose.

More frames, say, don't change the bed, and a new thing in the sea changes nothing else.
"""

from __future__ import annotations

import numpy as np

from pipeline_tracker.simulation.scenario import Scenario


def random_stream(scenario: Scenario, name: str, *index: int) -> np.random.Generator:
    """Return the random numbers for a purpose, and for one of many of its kind.

    Args:
        scenario: for its seed.
        name: the purpose.
        index: whole numbers from 0 on.
    """
    purpose = int.from_bytes(name.encode(), "big")
    return np.random.default_rng([scenario.seed, purpose, *index])
