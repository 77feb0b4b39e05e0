"""Any camera: sizes, shapes and calibrations, from pictures to the relative state."""

from __future__ import annotations

import numpy as np
import pytest
from rendering import pair
from swim import settings_of
from synthetic_world import DOWN, SECOND, World, level_pose

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.types import State

CAMERAS = {
    "small": Camera(260.0, 260.0, 159.5, 119.5, 320, 240),
    "odd": Camera(330.0, 330.0, 200.0, 140.0, 401, 283),
    "portrait": Camera(330.0, 330.0, 149.5, 223.5, 300, 448),
    "pixels are not square": Camera(400.0, 330.0, 219.5, 149.5, 440, 300),
    "middle is off": Camera(360.0, 360.0, 150.0, 210.0, 440, 320),
    "wider than the working size": Camera(1300.0, 1300.0, 804.5, 299.5, 1610, 600),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_pipe_is_followed_with_any_camera(name: str) -> None:
    left = CAMERAS[name]
    right = Camera(left.fx, left.fy, left.cx, left.cy, left.width, left.height, offset=0.2)
    rig = StereoRig(left, right)
    world = World.with_pipe(heading=0.15, ahead=0.3, aside=0.05)
    assert world.pipe is not None
    pipeline = Pipeline(settings_of(), DOWN)
    for k in range(3):
        pose = level_pose(x=0.25 * k)
        stamp = k * SECOND // 2
        pipeline.poses.add(stamp, pose)
        done = pipeline.process(stamp, rig, *pair(world, pose, DOWN, rig, seed=k))
        assert done.tracked.status.state == State.TRACKING
        assert (done.recognition is None) == (k > 0)
        assert done.relative_state.valid
        segment = done.tracked.segment
        assert segment is not None
        ends = np.stack((pose.apply(segment.start), pose.apply(segment.end)))
        # Half a pixel at 2 m.
        assert world.pipe.from_axis(ends).max() < 0.5 * 2.0 / min(left.fx, left.fy) + 0.001
