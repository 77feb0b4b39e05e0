"""A control law that follows the pipe: relative state in, velocities of the vehicle out.

Line-of-sight guidance, for a vehicle that goes forward and turns: it steers its course for a point
on the pipe some way ahead, and its height for a distance above it. Without a valid state it goes
straight on for a while, then stops. Nothing of ROS is in here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


class State(Protocol):
    """What is read of pipeline_tracker_msgs/RelativeState."""

    valid: bool
    reset_counter: int
    heading_misalignment: float
    lateral_offset: float
    min_distance_base: float


@dataclass(frozen=True)
class Command:
    """Velocities along the vehicle's own axes (REP 103: x forward, y left, z up).

    Attributes:
        surge: forward, m/s.
        heave: upward, m/s.
        yaw_rate: to port, rad/s.
    """

    surge: float = 0.0
    heave: float = 0.0
    yaw_rate: float = 0.0


@dataclass(frozen=True)
class Gains:
    """How it follows.

    Attributes:
        speed: along the pipe, m/s.
        distance: of base_link from the pipe's surface, m.
        lookahead: way to the point that it steers for, m.
        turn: yaw rate for an error of the course, 1/s; with the heading half a second old and a
            vehicle that answers late, more makes it swing.
        climb: vertical speed for an error of the distance, 1/s.
        most_yaw_rate, most_heave: never more than these, rad/s and m/s.
        hold: without a valid state it goes straight on for so long, s; then it stops.
    """

    speed: float = 0.4
    distance: float = 2.0
    lookahead: float = 2.0
    turn: float = 0.5
    climb: float = 0.5
    most_yaw_rate: float = 0.35
    most_heave: float = 0.2
    hold: float = 6.0


class PipeFollower:
    """Follows the pipe by relative states."""

    def __init__(self, gains: Gains | None = None) -> None:
        """Stand still until the first valid state."""
        self._gains = gains or Gains()
        self._seen: float | None = None
        self._steered = Command()
        self._resets: int | None = None

    def see(self, state: State, now: float) -> None:
        """Take in a relative state.

        Args:
            state: the state.
            now: time at which it holds, s.
        """
        if self._resets is not None and state.reset_counter != self._resets:
            # What was known before the reset says nothing any more: not even to go straight on.
            self._seen = None
        self._resets = state.reset_counter
        if not state.valid:
            return
        self._seen = now
        gains = self._gains
        # Positive, the pipe leads to port; positive, the vehicle is to port of it.
        course = state.heading_misalignment - math.atan2(state.lateral_offset, gains.lookahead)
        self._steered = Command(
            surge=gains.speed,
            heave=_within(
                gains.climb * (gains.distance - state.min_distance_base), gains.most_heave
            ),
            yaw_rate=_within(gains.turn * course, gains.most_yaw_rate),
        )

    def command(self, now: float) -> Command:
        """Return what the vehicle is to do at a time, s."""
        if self._seen is None or not 0.0 <= now - self._seen <= self._gains.hold:
            return Command()
        # A correction is for the moment it was measured in: later it only goes straight on.
        if now - self._seen > 1.0:
            return Command(surge=self._steered.surge)
        return self._steered


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))
