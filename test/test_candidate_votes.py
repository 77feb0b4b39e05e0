"""Votes for many candidates in one compiled pass, against the plain way of one at a time."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_world import MONO, RIG, Diver, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.support import contour_support


@pytest.mark.parametrize("rig", [RIG, MONO], ids=["stereo", "mono"])
@pytest.mark.parametrize("heading", [0.0, 0.7, 1.57, 3.0])
def test_it_counts_what_the_support_counts(heading: float, rig: object) -> None:
    cameras = RIG if rig is RIG else MONO
    diver = Diver(World.with_pipe(heading=heading, aside=0.2), cameras)
    frame = diver.frame(level_pose(), seed=3)
    random = np.random.default_rng(4)
    assert diver.world.pipe is not None
    to_optical = diver.mounting.inverse()
    point = to_optical.apply(diver.world.pipe.point)
    direction = to_optical.rotate(diver.world.pipe.direction)
    axes = [Axis.straight(point, direction)]
    axes += [
        Axis.straight(point + random.normal(0.0, 0.03, 3), direction + random.normal(0.0, 0.05, 3))
        for _ in range(30)
    ]
    votes = vote(frame, axes, 0.3)
    plain = [sum(c.contribution for c in contour_support(frame, axis, 0.3)) for axis in axes]
    assert np.allclose(votes, plain, rtol=1e-6, atol=0.5)
    # The true one wins.
    assert int(np.argmax(votes)) == 0
    assert votes[0] > 300.0


def test_nothing_behind_the_camera_or_round_it_gets_a_vote() -> None:
    frame = Diver(World.with_pipe()).frame(level_pose())
    forward = np.array([0.0, 1.0, 0.0])
    behind = Axis.straight(np.array([0.0, 0.0, -2.0]), forward)
    inside = Axis.straight(np.array([0.0, 0.0, 0.2]), forward)
    assert vote(frame, [behind, inside], 0.3).tolist() == [0.0, 0.0]
    assert vote(frame, [], 0.3).shape == (0,)
