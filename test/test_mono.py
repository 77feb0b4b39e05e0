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
from pipeline_tracker.mono import MonoFit, echo_hits, edge_spread, fit_mono
from pipeline_tracker.pipe_segment import axis_of_segment
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.support import contour_pieces
from pipeline_tracker.tracking.echo_trail import EchoTrail
from pipeline_tracker.tracking.mono_follower import MonoFollower, mono_refusal
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
    # Made-up edges are right on the contour, those of pictures 1.2 px outside of it.
    assert max(edge_spread(frame, found.fit.axis, 0.3, 0.2)) == pytest.approx(1.25 * 1.2, abs=0.05)


def test_edges_beside_a_contour_are_spread() -> None:
    frame = two_edged(World.with_pipe(), 0.33, level_pose(), 0, DOWN)
    axis = Axis.straight(DOWN.inverse().apply(np.array([0.0, 0.0, -2.0])), np.array([0.0, -1.0, 0]))
    assert min(edge_spread(frame, axis, 0.3, 0.2)) > 5.0
    assert max(edge_spread(frame, axis, 0.3, 0.03)) < 1.0


# As AXIS, but travelled as DOWN's vehicle goes; the vertical.
AHEAD_AXIS = Axis.straight(np.array([0.0, 0.0, 2.0]), np.array([0.0, -1.0, 0.0]))
UP = np.array([0.0, 0.0, -1.0])


def behind(count: int = 40, away: float = 4.0, top: float = 1.7) -> Echoes:
    """Beams straight down on the way behind, from below the camera to so many metres back."""
    origins = np.zeros((count, 3))
    origins[:, 1] = np.linspace(0.2, away, count)
    every = np.ones(count)
    return Echoes(origins, np.tile(AHEAD, (count, 1)), top * every, 0.03 * every, 0.0 * every)


def edges(side: int, radius: float, outside_brighter: bool) -> np.ndarray:
    """Edges along the left (0) or right (1) contour of a pipe of another radius, one of two."""
    x1, y1, x2, y2 = contour_pieces(AHEAD_AXIS, radius, MONO.left)[side][0]
    shares = np.linspace(0.0, 1.0, 17)
    xs, ys = x1 + shares * (x2 - x1), y1 + shares * (y2 - y1)
    rows = np.stack((xs[:-1], ys[:-1], xs[1:], ys[1:]), axis=1)[::2]
    # The brighter side is to the right of the way from the first end to the second.
    down = outside_brighter == (side == 0)
    if (rows[0, 3] > rows[0, 1]) != down:
        rows = rows[:, [2, 3, 0, 1]]
    return rows.astype(np.float32)


def seen(*rows: np.ndarray) -> VectorizedStereo:
    """A frame with these edges and no others."""
    frame = Diver(World.with_pipe(), MONO, DOWN, EXACT).frame(level_pose())
    return replace(frame, left_segments=np.concatenate(rows))


def error(found: MonoFit | None) -> np.ndarray:
    """How far a fit is to the right and below, m."""
    assert found is not None
    off: np.ndarray = found.fit.axis.point[[0, 2]] - [0.0, 2.0]
    return off


def test_edges_with_the_brighter_side_elsewhere_are_no_pair() -> None:
    # The edge of the pipe's bright middle at the left and that of its shadow at the right, as far
    # apart as the contours; the contours themselves are seen along less of their length.
    frame = seen(
        edges(0, 0.26, False),
        edges(1, 0.34, True),
        edges(0, 0.3, True)[::2],
        edges(1, 0.3, True)[::2],
    )
    found = fit_mono(frame, AHEAD_AXIS, 0.3, UP, behind())
    assert np.abs(error(found)).max() < 0.02


def test_between_pairs_as_good_as_each_other_it_takes_the_middle_and_says_so() -> None:
    frame = seen(*(edges(side, radius, True) for side in (0, 1) for radius in (0.27, 0.33)))
    found = fit_mono(frame, AHEAD_AXIS, 0.3, UP, behind())
    assert abs(error(found)[0]) < 0.015
    assert found is not None
    assert math.sqrt(found.fit.covariance[0, 0]) > 0.01


def test_edges_spread_widely_leave_the_height_to_the_echoes() -> None:
    clean = [edges(side, 0.3, True) for side in (0, 1)]
    foot = [edges(side, 0.307, True) for side in (0, 1)]
    sigmas = []
    for frame in (seen(*clean), seen(*clean, *foot)):
        found = fit_mono(frame, AHEAD_AXIS, 0.3, UP, behind(10))
        assert found is not None
        assert abs(error(found)[1]) < 0.04
        sigmas.append(math.sqrt(found.fit.covariance[1, 1]))
    assert sigmas[1] > 2.0 * sigmas[0]


@pytest.mark.parametrize("above", [0.35, -0.3])
@pytest.mark.parametrize("pitch", [0.0, 0.4])
def test_a_start_at_the_wrong_height_is_put_below_the_echoes(above: float, pitch: float) -> None:
    frame = seen(edges(0, 0.3, True), edges(1, 0.3, True))
    start = Axis.straight(
        np.array([0.0, 0.0, 2.0 - above]), np.array([0.0, -math.cos(pitch), math.sin(pitch)])
    )
    assert np.abs(error(fit_mono(frame, start, 0.3, UP, behind()))).max() < 0.02


def test_where_the_pipe_was_seen_tells_where_on_its_round_a_beam_went_down() -> None:
    # The pipe bends: where the beam met it, it lay 0.2 m beside the axis as it goes on from here.
    low = 2.0 - math.sqrt(0.3**2 - 0.2**2)
    echo = replace(behind(1, top=low), origins=np.array([[0.0, 3.0, 0.0]]))
    for passed, radius in ((np.zeros((0, 3)), 2.0 - low), (np.array([[0.2, 2.8, 2.0]]), 0.3)):
        points, _ = echo_hits(replace(echo, passed=passed), AHEAD_AXIS, 0.3)
        assert len(points) == 1
        assert np.hypot(points[0, 0], points[0, 2] - 2.0) == pytest.approx(radius, abs=1e-6)
    # A place far along the pipe tells nothing of it.
    far = replace(echo, passed=np.array([[0.2, 1.0, 2.0]]))
    assert echo_hits(far, AHEAD_AXIS, 0.3)[0][0, 0] == 0.0


def following() -> MonoFollower:
    """A follower that has heard the pipe on the way behind."""
    settings = settings_of().model_copy(update={"mode": "mono"})
    follower = MonoFollower(settings, DOWN)
    down = np.array([0.0, 0.0, -1.0])
    follower.hear(
        [
            PlacedEcho(Echo(k, DOWN.apply(origin), down, 1.7, 0.03, 0.0), level_pose())
            for k, origin in enumerate(behind().origins)
        ]
    )
    return follower


@pytest.mark.parametrize(("spread", "why"), [(2.0, ""), (2.2, "contours_not_clear")])
def test_edges_spread_widely_are_refused_though_echoes_are_heard(spread: float, why: str) -> None:
    frame = seen(edges(0, 0.3, True), edges(1, 0.3, True))
    found = fit_mono(frame, AHEAD_AXIS, 0.3, UP, behind())
    assert found is not None
    assert mono_refusal(replace(found, spread=spread), MONO.left) == why


def test_accepted_frames_are_remembered_along_the_way() -> None:
    follower = following()
    frame = seen(edges(0, 0.3, True), edges(1, 0.3, True))
    found, covariance, reason = follower.fit(frame, level_pose(), AHEAD_AXIS, UP)
    assert found is not None
    assert reason == ""
    # The published one: 0.7 of the fit's, and a little for calibration.
    assert math.sqrt(covariance[1, 1]) < 0.8 * math.sqrt(found.fit.covariance[1, 1])
    # 1 m on, the places are 1 m further behind.
    there = follower.around(10**9, level_pose(x=1.0)).seen_from(DOWN.inverse()).passed
    assert there[:, 1] == pytest.approx([1.5, 1.0, 0.5], abs=0.02)
    assert np.abs(there[:, [0, 2]] - [0.0, 2.0]).max() < 0.02
    follower.forget()
    assert len(follower.around(10**9, level_pose(x=1.0)).passed) == 0
