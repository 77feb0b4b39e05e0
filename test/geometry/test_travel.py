"""The direction of travel: chosen, kept, and turned late."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.travel import TravelDirection

Array = NDArray[np.float64]

EAST = np.array([1.0, 0.0, 0.0])
NORTH = np.array([0.0, 1.0, 0.0])


def heading(degrees: float, length: float = 1.0) -> Array:
    angle = math.radians(degrees)
    return length * np.array([math.cos(angle), math.sin(angle), 0.0])


def test_at_first_it_follows_the_motion() -> None:
    direction, turned = TravelDirection().update(EAST, heading(100.0), EAST)
    np.testing.assert_array_equal(direction, -EAST)
    assert not turned


def test_without_motion_it_follows_the_vehicles_axis() -> None:
    direction, _ = TravelDirection().update(-EAST, None, heading(80.0))
    np.testing.assert_array_equal(direction, EAST)


def test_it_is_kept_whichever_way_round_the_line_comes() -> None:
    travel = TravelDirection()
    travel.update(EAST, EAST, EAST)
    for line in (-EAST, EAST, heading(200.0), heading(-20.0)):
        direction, _ = travel.update(line, None, -EAST)
        assert direction @ EAST > 0.0


def test_it_follows_a_bend_all_the_way_round() -> None:
    travel = TravelDirection()
    travel.update(EAST, EAST, EAST)
    for degrees in range(0, 360, 10):
        direction, turned = travel.update(-heading(degrees), heading(degrees), EAST)
        np.testing.assert_allclose(direction, heading(degrees), atol=1e-12)
        assert not turned


def test_it_turns_in_the_third_frame_astern() -> None:
    travel = TravelDirection()
    travel.update(EAST, EAST, EAST)
    for expected_turn in (False, False, True, False, False, False, False):
        direction, turned = travel.update(EAST, -EAST, EAST)
        assert turned == expected_turn
    np.testing.assert_array_equal(direction, -EAST)


def test_an_interrupted_run_astern_does_not_turn_it() -> None:
    travel = TravelDirection()
    travel.update(EAST, EAST, EAST)
    for motion in (-EAST, -EAST, None, -EAST, -EAST, NORTH, -EAST, -EAST):
        direction, turned = travel.update(EAST, motion, EAST)
        assert not turned
    np.testing.assert_array_equal(direction, EAST)


def test_crossing_backwards_at_less_than_120_degrees_never_turns_it() -> None:
    for degrees, turns in ((119.0, False), (121.0, True)):
        travel = TravelDirection()
        travel.update(EAST, EAST, EAST)
        seen = [travel.update(EAST, heading(degrees, 0.1), EAST)[1] for _ in range(10)]
        assert any(seen) == turns


def test_reset_forgets() -> None:
    travel = TravelDirection()
    travel.update(EAST, EAST, EAST)
    travel.update(EAST, -EAST, EAST)
    travel.reset()
    assert travel.direction is None
    direction, _ = travel.update(EAST, -EAST, EAST)
    np.testing.assert_array_equal(direction, -EAST)
