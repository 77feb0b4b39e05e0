from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.truth import (
    HIDDEN,
    OUTSIDE,
    VISIBLE,
    Contours,
    contour_points,
    frame_contours,
    stretch_in_view,
)


def contours(sea: Sea, time: float, index: int) -> Contours:
    base = sea.motion.pose(time)
    cameras = sea.scenario.camera.rig().cameras
    poses = tuple(base @ mounting for mounting in sea.mountings())
    s = stretch_in_view(sea.scene.axis, cameras, poses)
    return frame_contours(sea.scene.axis, sea.scene.caster, cameras[index], poses[index], s)


def test_contours_lie_on_the_pipe_and_graze_it(sea: Sea) -> None:
    centre = np.array([1.0, 0.3, 2.4])
    s = np.linspace(0.0, 4.0, 41)
    points, normals = contour_points(sea.scene.axis, s, centre)
    radius = np.linalg.norm(points - sea.scene.axis.points(s), axis=-1)
    np.testing.assert_allclose(radius, 0.3, atol=1e-9)
    sight = points - centre
    np.testing.assert_allclose(np.sum(sight * normals, axis=-1), 0.0, atol=1e-9)
    # Side 0 is left of travel: towards y for a pipe along x.
    assert (points[0, :, 1] > points[1, :, 1]).all()


def test_silt_hides_the_contour_that_it_covers(small: Callable[..., Scenario]) -> None:
    # A heap to starboard, and one wholly over the pipe further on.
    drifts = (
        "bed.drifts=[{at: 1.5, offset: -0.45, length: 0.3, width: 0.3, height: 0.6},"
        "{at: 3.0, offset: 0, length: 0.3, width: 1.5, height: 1.2}]"
    )
    found = contours(
        build_sea(small(drifts, "bed.resolution=0.03", "path.lateral_start=0")), 0.0, 0
    )
    at_heap = np.abs(found.chainage - 1.5) < 0.1
    in_view = found.flags != OUTSIDE
    assert (found.flags[1, at_heap & in_view[1]] == HIDDEN).all()
    assert (found.flags[0, at_heap & in_view[0]] == VISIBLE).all()
    buried = np.abs(found.chainage - 3.0) < 0.1
    assert (buried & in_view[0]).any()
    assert (found.flags[:, buried][in_view[:, buried]] == HIDDEN).all()


def test_flags_outside_are_the_pixels_outside(sea: Sea) -> None:
    found = contours(sea, 1.0, 1)
    x, y = np.moveaxis(found.pixels, -1, 0)
    camera = sea.scenario.camera
    inside = (x >= -0.5) & (x <= camera.width - 0.5) & (y >= -0.5) & (y <= camera.height - 0.5)
    np.testing.assert_array_equal(found.flags != OUTSIDE, inside)
    # The stretch is longer than the view, at both ends.
    assert not inside[:, 0].any()
    assert not inside[:, -1].any()


def test_the_left_contour_is_on_the_left_where_the_pipe_runs_up_the_image(sea: Sea) -> None:
    found = contours(sea, 0.0, 0)
    both = (found.flags != OUTSIDE).all(axis=0)
    assert both.any()
    assert (found.pixels[0, both, 0] < found.pixels[1, both, 0]).all()


def test_nothing_in_view_is_an_empty_stretch(sea: Sea) -> None:
    cameras = sea.scenario.camera.rig().cameras
    pose = sea.motion.pose(0.0) @ sea.mountings()[0]
    # Turned about: the camera looks up.
    up = type(pose)(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.translation)
    assert len(stretch_in_view(sea.scene.axis, cameras[:1], (up,))) == 0


def test_in_oneside_one_contour_leaves_both_images_and_comes_back() -> None:
    sea = build_sea(load_scenario("oneside", ["bed.resolution=0.1", "bed.stones=0"]))

    def seen(pair: int) -> tuple[float, float]:
        """Return how much of the left and of the right contour is in view of any camera, m."""
        views = [contours(sea, float(pair), index) for index in range(2)]
        left, right = (
            0.05 * float(np.max([np.sum(view.flags[side] == VISIBLE) for view in views]))
            for side in range(2)
        )
        return left, right

    for pair in (0, 8, 30, 39):
        assert min(seen(pair)) > 2.0
    for pair in (13, 16, 19, 22, 25):
        left, right = seen(pair)
        assert left > 2.0
        assert right == 0.0
