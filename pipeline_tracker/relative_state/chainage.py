"""Distance travelled along the pipe (4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Chainage:
    """Sum of the vehicle's way projected on the pipe's direction, since a reference point.

    Its sense is the direction of travel at the reference point and stays so when the vehicle turns
    round: the chainage of a place does not depend on how the vehicle came back to it.
    """

    def __init__(self) -> None:
        """Start without a reference point: the first place given to ``advance`` is one."""
        self._anchor: Array | None = None
        self._direction: Array | None = None
        self._value = 0.0

    def advance(self, position: Array, travel: Array) -> float:
        """Add the way since the last call; frames without a pipe in between are bridged by it.

        Args:
            position: base_link's origin in odom, (3,), m.
            travel: the pipe's direction along travel in odom, (3,), unit.

        Returns:
            Chainage, m.
        """
        previous = self._direction
        direction = travel if previous is None or float(previous @ travel) >= 0.0 else -travel
        if self._anchor is not None:
            # The chord of an arc is parallel to the mean of the directions at its ends.
            mean = direction if previous is None else direction + previous
            mean = mean / np.linalg.norm(mean)
            self._value += float((position - self._anchor) @ mean)
        self._anchor, self._direction = position, direction
        return self._value

    def set_reference(self, position: Array | None) -> None:
        """Make a place the reference point.

        Args:
            position: base_link's origin in odom, (3,), m; None: the next place given to
                ``advance``.
        """
        self._value = 0.0
        self._anchor = position
        self._direction = None
