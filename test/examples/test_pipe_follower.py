from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pipe_follower import Command, Gains, PipeFollower


@dataclass
class Told:
    valid: bool = True
    reset_counter: int = 0
    heading_misalignment: float = 0.0
    lateral_offset: float = 0.0
    min_distance_base: float = 2.0


def commanded(**fields: float) -> Command:
    follower = PipeFollower()
    follower.see(Told(**fields), 1.0)  # type: ignore[arg-type]
    return follower.command(1.0)


def test_it_stands_still_until_something_is_known() -> None:
    follower = PipeFollower()
    assert follower.command(0.0) == Command()
    follower.see(Told(valid=False), 0.0)
    assert follower.command(0.0) == Command()


def test_signs() -> None:
    # The pipe leads to port: turn to port. The vehicle is to port of it: turn to starboard.
    assert commanded(heading_misalignment=0.2).yaw_rate > 0.0
    assert commanded(lateral_offset=0.5).yaw_rate < 0.0
    # Too far above it: descend.
    assert commanded(min_distance_base=2.5).heave < 0.0
    assert commanded().surge == Gains().speed
    assert commanded().yaw_rate == 0.0


def test_commands_are_bounded() -> None:
    wild = commanded(heading_misalignment=3.0, min_distance_base=50.0)
    assert wild.yaw_rate == Gains().most_yaw_rate
    assert wild.heave == -Gains().most_heave


def test_without_a_valid_state_it_goes_straight_on_and_stops() -> None:
    follower = PipeFollower()
    follower.see(Told(heading_misalignment=0.3), 10.0)
    assert follower.command(10.5).yaw_rate > 0.0
    follower.see(Told(valid=False), 11.5)
    assert follower.command(11.5) == Command(surge=Gains().speed)
    assert follower.command(10.1 + Gains().hold) == Command()
    # A clock that went back tells nothing.
    assert follower.command(9.0) == Command()


def test_a_reset_stops_it() -> None:
    follower = PipeFollower()
    follower.see(Told(), 0.0)
    follower.see(Told(valid=False, reset_counter=1), 0.5)
    assert follower.command(0.5) == Command()


def test_it_converges_on_a_straight_pipe() -> None:
    """A vehicle without delay, from 1 m aside and 40 degrees off."""
    follower, place, yaw = PipeFollower(), np.array([0.0, 1.0]), math.radians(40.0)
    for step in range(400):
        now = 0.1 * step
        follower.see(Told(heading_misalignment=-yaw, lateral_offset=float(place[1])), now)
        command = follower.command(now)
        yaw += 0.1 * command.yaw_rate
        place += 0.1 * command.surge * np.array([math.cos(yaw), math.sin(yaw)])
    assert abs(place[1]) < 0.01
    assert abs(yaw) < 0.01
    assert place[0] > 10.0
