"""Rays from the end of the previous piece, ranked by their votes (4.1, steps 2 to 5)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_world import DOWN, MONO, TILTED, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis, across
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.tracking.candidates import best_candidate

Array = NDArray[np.float64]


def truth(diver: Diver) -> tuple[Array, Array, Array]:
    """A point of the axis in the middle of the view, its direction, and up; left optical frame."""
    assert diver.world.pipe is not None
    to_optical = diver.mounting.inverse()
    point = to_optical.apply(diver.world.pipe.point)
    direction = to_optical.rotate(diver.world.pipe.direction)
    flat = direction[:2]
    point = point - direction * float(point[:2] @ flat / (flat @ flat))
    return point, direction, to_optical.rotate([0.0, 0.0, 1.0])


@pytest.mark.parametrize("mounting", [DOWN, TILTED], ids=["down", "tilted"])
@pytest.mark.parametrize("heading", [0.0, 0.8, 2.6])
@pytest.mark.parametrize("turn", [(0.0, 0.0), (0.08, 0.0), (-0.1, 0.06), (0.03, -0.1)])
def test_the_ray_along_the_pipe_wins(
    turn: tuple[float, float], heading: float, mounting: Pose
) -> None:
    ahead = 0.3 if mounting is DOWN else 1.3
    diver = Diver(World.with_pipe(heading=heading, ahead=ahead), mounting=mounting)
    frame = diver.frame(level_pose(), seed=2)
    point, direction, up = truth(diver)
    left, normal = across(direction, up)
    before = direction + turn[0] * left + turn[1] * normal
    before /= np.linalg.norm(before)
    axis, votes = best_candidate(frame, point, before, 0.3, up)
    # The finest grid has steps of 0.13 degrees; pitch shows little from above.
    assert abs((axis.direction - direction) @ left) < 0.006
    assert abs((axis.direction - direction) @ normal) < 0.03
    assert np.array_equal(axis.point, point)
    assert votes == pytest.approx(float(vote(frame, [axis], 0.3)[0]), rel=1e-6)
    # From coarse to fine it ends within a few steps of the very best.
    assert votes > 0.9 * float(vote(frame, [Axis.straight(point, direction)], 0.3)[0])


def test_of_equal_votes_the_previous_direction_is_kept() -> None:
    # Nothing is seen: all have none.
    diver = Diver(World.with_pipe(), look=Look(seen=(0.0, 0.0, 0.0, 0.0), clutter=0))
    frame = diver.frame(level_pose())
    point, direction, up = truth(diver)
    axis, votes = best_candidate(frame, point, direction, 0.3, up)
    assert votes == 0.0
    assert np.allclose(axis.direction, direction)


def test_segments_far_off_do_not_count_and_change_nothing() -> None:
    near = Diver(World.with_pipe(), look=Look(clutter=0))
    point, direction, up = truth(near)
    frame = near.frame(level_pose(), seed=4)
    axis, votes = best_candidate(frame, point, direction, 0.3, up)
    # A long line 300 px beside the pipe, in both images.
    line = np.array([[100.0, 50.0, 100.0, 750.0]], np.float32)
    more = replace(
        frame,
        left_segments=np.concatenate((frame.left_segments, line)),
        right_segments=np.concatenate((frame.right_segments, line)),
    )
    other, same = best_candidate(more, point, direction, 0.3, up)
    assert same == votes
    assert np.array_equal(other.direction, axis.direction)


def test_one_camera_is_enough() -> None:
    diver = Diver(World.with_pipe(heading=0.4), MONO)
    point, direction, up = truth(diver)
    left, _ = across(direction, up)
    before = direction + 0.07 * left
    axis, _ = best_candidate(
        diver.frame(level_pose()), point, before / np.linalg.norm(before), 0.3, up
    )
    assert math.degrees(math.acos(min(1.0, float(axis.direction @ direction)))) < 2.0
