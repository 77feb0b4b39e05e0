"""Which of its two directions a pipe has: the one in which the vehicle travels (4.3)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TURN_ANGLE = math.radians(120.0)
TURN_FRAMES = 3


class TravelDirection:
    """The pipe's direction D along travel, carried from frame to frame.

    At first D points as the vehicle moves (or looks, while it does not move). It is then kept, and
    turned only when the motion has been more than 120 degrees from it for three frames in a row:
    heading, side and offset do not jump at crossings, when hovering and at each metre astern.
    """

    def __init__(self) -> None:
        """Start without a direction."""
        self._direction: Array | None = None
        self._against = 0

    @property
    def direction(self) -> Array | None:
        """The present direction, unit, (3,); None before the first update."""
        return self._direction

    def update(self, line: Array, motion: Array | None, forward: Array) -> tuple[Array, bool]:
        """Choose between the two directions of a line.

        Args:
            line: the line's direction, (3,), unit, either way round; in a fixed frame, as the rest.
            motion: the vehicle's displacement S, (3,); None while it has no direction of motion.
            forward: the vehicle's levelled x axis, (3,).

        Returns:
            D, unit, (3,), and whether it was turned in this frame.
        """
        kept = self._direction
        if kept is None:
            kept = forward if motion is None else motion
        direction = -line if float(line @ kept) < 0.0 else line
        self._against = self._against + 1 if _opposed(motion, direction) else 0
        turned = self._against >= TURN_FRAMES
        if turned:
            direction = -direction
            self._against = 0
        self._direction = direction
        return direction, turned

    def reset(self) -> None:
        """Forget the direction."""
        self._direction = None
        self._against = 0


def _opposed(motion: Array | None, direction: Array) -> bool:
    if motion is None:
        return False
    return float(motion @ direction) < math.cos(TURN_ANGLE) * float(np.linalg.norm(motion))
