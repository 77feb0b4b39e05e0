"""One camera: echoes and contours together, and honesty where they do not suffice."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from swim import settings_of
from synthetic_world import DOWN, EXACT, MONO, SECOND, TILTED, Diver, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.echoes import Echo, EchoBuffer, Echoes, PlacedEcho
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.mono import echo_hits, edge_spread, fit_mono
from pipeline_tracker.pipe_segment import axis_of_segment
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.tracking.echo_trail import EchoTrail
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import State, VectorizedStereo

AXIS = Axis.straight(np.array([0.0, 0.0, 2.0]), np.array([0.0, 1.0, 0.0]))
AHEAD = np.array([0.0, 0.0, 1.0])


def beams(origin: list[float], distance: float, half_angle: float = 0.0) -> Echoes:
    """A beam along z of the axis' frame."""
    return Echoes(
        np.array([origin]),
        AHEAD[None],
        np.array([distance]),
        np.array([0.02]),
        np.array([half_angle]),
    )


def test_a_narrow_beam_meets_the_pipe_below_it() -> None:
    points, sigmas = echo_hits(beams([0.1, 0.4, 0.0], 1.7), AXIS, 0.3)
    assert points.tolist() == [[0.1, 0.4, 1.7]]
    assert sigmas[0] > 0.02


def test_a_beam_beside_the_pipe_meets_the_bed() -> None:
    for aside in (0.25, 0.5, -0.4):
        assert len(echo_hits(beams([aside, 0.0, 0.0], 1.8), AXIS, 0.3)[0]) == 0


def test_a_wide_beam_beside_the_pipe_meets_its_nearest_place() -> None:
    aside = 0.2
    # The nearest place is within the beam: 1.71 m away on the way to the axis.
    points, _ = echo_hits(beams([aside, 0.0, 0.0], math.hypot(2.0, aside) - 0.3, 0.15), AXIS, 0.3)
    assert np.hypot(points[0, 0], points[0, 2] - 2.0) == pytest.approx(0.3, abs=1e-9)


def test_echoes_far_behind_say_nothing() -> None:
    assert len(echo_hits(beams([0.0, -7.0, 0.0], 1.7), AXIS, 0.3)[0]) == 0
    assert len(echo_hits(Echoes.none(), AXIS, 0.3)[0]) == 0


def echo(stamp: int, distance: float = 1.7) -> Echo:
    return Echo(stamp, np.zeros(3), np.array([0.0, 0.0, -1.0]), distance, 0.03, 0.0)


def test_echoes_are_handed_out_once_with_their_poses() -> None:
    poses, buffer = PoseBuffer(3.0), EchoBuffer()
    for k in range(3):
        poses.add(k * SECOND, level_pose(x=1.0 * k))
    assert buffer.silent_for(SECOND, 5.0)
    assert buffer.add(SECOND // 2, echo(SECOND // 2))
    assert buffer.add(SECOND, None)
    assert not buffer.add(SECOND, echo(SECOND))
    assert buffer.settled(SECOND)
    assert not buffer.settled(SECOND + 1)
    assert not buffer.silent_for(2 * SECOND, 5.0)
    taken = buffer.take(SECOND, poses)
    assert [placed.echo.stamp_ns for placed in taken] == [SECOND // 2]
    assert taken[0].pose is not None
    assert taken[0].pose.translation.tolist() == [0.5, 0.0, 0.0]
    assert buffer.take(2 * SECOND, poses) == []


def test_the_trail_carries_echoes_along_and_ends_behind() -> None:
    trail = EchoTrail(max_age=0.5)
    trail.add([PlacedEcho(echo(k * SECOND), level_pose(x=1.0 * k)) for k in range(9)])
    around = trail.around(8 * SECOND, level_pose(x=8.0))
    assert around.origins[:, 0].tolist() == [-4.0, -3.0, -2.0, -1.0, 0.0]
    assert (np.diff(around.sigmas) < 0.0).all()
    # Without a pose only the last one, while it is fresh.
    assert len(trail.around(8 * SECOND + SECOND // 4, None)) == 1
    assert len(trail.around(9 * SECOND, None)) == 0
    trail.clear()
    assert len(trail.around(8 * SECOND, level_pose(x=8.0))) == 0


def two_edged(world: World, fat: float, pose: Pose, stamp: int, mounting: Pose) -> VectorizedStereo:
    """A frame with the edges of the pipe, and stronger ones beside them (of its foot)."""
    assert world.pipe is not None
    look = replace(EXACT, seen=(0.8, 0.8, 0.8, 0.8), clutter=0)
    frame = Diver(world, MONO, mounting, look).frame(pose, stamp)
    wide = World(world.bed, replace(world.pipe, radius=fat))
    other = Diver(wide, MONO, mounting, replace(look, seen=(1.0,) * 4)).frame(pose, stamp)
    both = np.concatenate((frame.left_segments, other.left_segments))
    return replace(frame, left_segments=both)


def follow(world: World, fat: float, *, sounder: bool) -> list[tuple[TrackedFrame, float]]:
    """Swim along the pipe; what became of each frame, and its error in m."""
    settings = settings_of().model_copy(update={"mode": "mono"})
    tracker, recognizer = Tracker(settings, TILTED), Recognizer(settings, TILTED)
    diver, out = Diver(world, MONO, TILTED), []
    for k in range(12):
        pose, stamp = level_pose(x=0.5 * k), k * SECOND
        heard = []
        for n in range(10 if sounder else 0):
            there = level_pose(x=0.5 * (k - 0.1 * n))
            down = np.array([[0.0, 0.0, -1.0]])
            distance = float(world.hit(there.translation, down)[0])
            heard.append(PlacedEcho(echo(stamp - n * SECOND // 10, distance), there))
        frame = two_edged(world, fat, pose, stamp, TILTED)
        tracked = tracker.begin(frame, pose, heard[::-1])
        if tracked is None:
            tracked = tracker.finish(recognizer.recognize(frame))
        seen = tracked.segment is not None and tracked.status.state == State.TRACKING
        error = diver.errors(tracked.segment, pose)[0] if seen and tracked.segment else math.nan
        out.append((tracked, error))
    return out


def test_the_sounder_tells_the_contour_from_the_edge_beside_it() -> None:
    done = follow(World.with_pipe(aside=0.05), 0.33, sounder=True)
    errors = [error for _, error in done if not math.isnan(error)]
    assert len(errors) >= 5
    assert max(errors) < 0.03


def test_without_a_sounder_two_edges_are_not_guessed_between() -> None:
    for tracked, _ in follow(World.with_pipe(aside=0.05), 0.33, sounder=False):
        assert tracked.status.state == State.SEARCHING
        assert tracked.status.reason in {
            "contours_not_clear",
            "too_uncertain",
            "too_little_contour",
        }


def test_clean_contours_need_no_sounder() -> None:
    world = World.with_pipe(aside=0.05, height=1.0)
    frame = Diver(world, MONO, DOWN, EXACT).frame(level_pose())
    settings = settings_of().model_copy(update={"mode": "mono"})
    start = axis_of_segment(Recognizer(settings, DOWN).recognize(frame), DOWN)
    vertical = DOWN.rotation.T @ np.array([0.0, 0.0, 1.0])
    found = fit_mono(frame, start, 0.3, vertical, Echoes.none())
    assert found is not None
    assert found.hits == 0
    assert max(edge_spread(frame, found.fit.axis, 0.3, 0.2)) < 1.0


def test_edges_beside_a_contour_are_spread() -> None:
    frame = two_edged(World.with_pipe(), 0.33, level_pose(), 0, DOWN)
    axis = Axis.straight(DOWN.inverse().apply(np.array([0.0, 0.0, -2.0])), np.array([0.0, -1.0, 0]))
    assert min(edge_spread(frame, axis, 0.3, 0.2)) > 5.0
    assert max(edge_spread(frame, axis, 0.3, 0.03)) < 1.0
