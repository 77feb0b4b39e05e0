"""Following the pipe through made-up frames; the state machine and its reasons (4.1)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from swim import Swim, middle, settings_of
from synthetic_world import (
    DOWN,
    EXACT,
    MONO,
    TILTED,
    Bed,
    Diver,
    Look,
    Pipe,
    World,
    level_pose,
)

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import Contours, Mode, State

LOOK = Look(spacing=48)
ALL = Contours(15)


def diver(look: Look = LOOK, *, mounting: Pose = DOWN, **pipe: float) -> Diver:
    return Diver(World.with_pipe(**pipe), mounting=mounting, look=look)


def along(swim: Swim, count: int, step: float = 0.3, period: float = 0.6) -> list[TrackedFrame]:
    """Swim along x, ``count`` frames."""
    return [swim.step(k * period, level_pose(x=k * step)) for k in range(count)]


# Following.


@pytest.mark.parametrize("mounting", [DOWN, TILTED], ids=["down", "tilted"])
def test_it_searches_once_and_then_follows(mounting: Pose) -> None:
    seen = diver(mounting=mounting, heading=0.1, aside=-0.1)
    swim = Swim(seen)
    frames = along(swim, 6)
    assert swim.asked == 1
    assert [frame.status.state for frame in frames] == [State.TRACKING] * 6
    modes = [frame.segment.mode for frame in frames if frame.segment]
    assert modes == [Mode.RECOGNITION] + [Mode.TRACKING] * 5
    for k, frame in enumerate(frames):
        assert frame.segment is not None
        pose = level_pose(x=0.3 * k)
        away, turn = seen.errors(frame.segment, pose)
        assert away < 0.01
        assert turn < math.radians(0.5)
        assert frame.status.stamp_ns == frame.segment.stamp_ns == round(0.6e9 * k)
        assert frame.status.support == frame.segment.support > 0.5
        assert frame.status.seconds_since_seen == 0.0
        assert frame.status.reason == ""
        assert frame.status.reset_counter == 0
        assert frame.segment.visible_contours == ALL


def test_it_follows_a_bend_and_a_slope_past_a_vehicle_that_rolls() -> None:
    pipe = Pipe(np.array([0.3, 0.0, -2.0]), 0.0, -0.05, 0.3, 0.04)
    seen = Diver(World(Bed(-2.6), pipe), look=LOOK)
    swim = Swim(seen)
    for k in range(8):
        s = 0.35 * k
        place, tangent = pipe.axis(np.array([s]))
        yaw = math.atan2(tangent[0, 1], tangent[0, 0])
        roll, pitch = 0.08 * math.sin(1.3 * k), 0.06 * math.cos(0.9 * k)
        pose = Pose.from_rpy(place[0] + [0.0, 0.15, 2.0], [roll, pitch, yaw + 0.1])
        frame = swim.step(0.7 * k, pose)
        assert frame.status.state == State.TRACKING, frame.status
        assert frame.segment is not None
        away, turn = seen.errors(frame.segment, pose)
        assert away < 0.01
        assert turn < math.radians(0.6)
    assert swim.asked == 1


def test_the_piece_is_half_a_metre_in_the_middle_of_the_view_on_the_bent_axis() -> None:
    seen = diver(EXACT, mounting=TILTED, curvature=0.05, ahead=1.3)
    swim = Swim(seen)
    for k in range(3):
        pose = level_pose(x=0.3 * k)
        frame = swim.step(0.6 * k, pose)
        assert frame.segment is not None
        start, end = frame.segment.start, frame.segment.end
        assert np.linalg.norm(end - start) == pytest.approx(0.5, abs=1e-3)
        # Nearest the optical axis in its middle.
        to_optical = TILTED.inverse()
        first, last = to_optical.apply(start), to_optical.apply(end)
        assert abs(0.5 * (first + last)[:2] @ (last - first)[:2]) < 3e-3
        # Both ends on the bent axis: its chord would be off by 1.6 mm in the middle.
        assert seen.errors(frame.segment, pose)[0] < 1e-3
        assert seen.world.pipe is not None
        off = seen.world.pipe.from_axis(pose.apply(middle(frame))[None])[0]
        assert off == pytest.approx(0.5**2 / 8.0 * 0.05, abs=6e-4)


def test_mono_follows_by_both_contours() -> None:
    seen = Diver(World.with_pipe(heading=0.1), MONO, look=LOOK)
    swim = Swim(seen)
    frames = along(swim, 6)
    for k, frame in enumerate(frames):
        assert frame.status.state == State.TRACKING, frame.status
        assert frame.segment is not None
        away, turn = seen.errors(frame.segment, level_pose(x=0.3 * k))
        assert away < 0.03
        assert turn < math.radians(2.0)
    assert swim.asked == 1


def test_without_refinement_it_gives_the_papers_discrete_result() -> None:
    seen = diver(heading=0.1)
    swim = Swim(seen, settings_of(tracking={"refine": False}))
    frames = along(swim, 6)
    assert swim.asked == 1
    for k, frame in enumerate(frames):
        assert frame.status.state == State.TRACKING
        assert frame.segment is not None
        # A grid of 0.13 degrees, from ends that carry the errors of those before.
        away, turn = seen.errors(frame.segment, level_pose(x=0.3 * k))
        assert away < 0.05
        assert turn < math.radians(2.0)
    # All discrete results claim the same covariance, larger than that of a fit.
    covariances = [frame.segment.covariance for frame in frames[1:] if frame.segment]
    assert all(np.array_equal(c, covariances[0]) for c in covariances)
    fitted = along(Swim(seen), 2)[1].segment
    assert fitted is not None
    assert (np.diag(covariances[0]) > np.diag(fitted.covariance)).all()


def test_its_covariance_covers_its_errors() -> None:
    seen = diver(heading=0.1)
    assert seen.world.pipe is not None
    true = seen.world.pipe.direction
    left = np.cross([0.0, 0.0, 1.0], true)
    up = np.cross(true, left)
    squares = []
    for k, frame in enumerate(along(Swim(seen), 12)):
        assert frame.segment is not None
        step = frame.segment.end - frame.segment.start
        off = level_pose(x=0.3 * k).apply(middle(frame)) - seen.world.pipe.point
        off = off - true * (off @ true)
        turn = step / np.linalg.norm(step) - true
        error = np.array([off @ left, off @ up, turn @ left, turn @ up])
        squares.append(float(error @ np.linalg.solve(frame.segment.covariance, error)))
    assert np.mean(squares) < 6.0
    assert np.max(squares) < 25.0


def test_the_same_frames_give_the_same_bits() -> None:
    runs = []
    for _ in range(2):
        swim = Swim(diver(heading=0.2))
        frames = along(swim, 3)
        swim.lose_pipe()
        frames.append(swim.step(2.4, level_pose(x=1.2)))
        runs.append(frames)
    for one, other in zip(*runs, strict=True):
        assert replace(one.status, processing_time=0.0) == replace(
            other.status, processing_time=0.0
        )
        assert one.segment is not None
        assert other.segment is not None
        for name in ("start", "end", "covariance", "contours"):
            assert np.array_equal(getattr(one.segment, name), getattr(other.segment, name))


# Losing and finding.


def test_it_coasts_and_then_searches_and_then_follows_again() -> None:
    seen = diver(heading=0.1)
    swim = Swim(seen, settings_of(tracking={"max_coast": 10.0, "max_coast_time": 1.5}))
    along(swim, 2)
    swim.lose_pipe()
    sure = None
    for k, expected in ((2, 0.6), (3, 1.2)):
        pose = level_pose(x=0.3 * k)
        frame = swim.step(0.6 * k, pose)
        assert frame.status.state == State.COASTING
        assert frame.status.seconds_since_seen == pytest.approx(expected)
        assert frame.status.support == 0.0
        assert "pipe_not_found" in frame.status.reason
        # It is where the pose carried it, and less and less sure.
        assert frame.segment is not None
        assert frame.segment.mode == Mode.TRACKING
        assert frame.segment.support == 0.0
        assert frame.segment.visible_contours == Contours.NONE
        assert seen.errors(frame.segment, pose)[0] < 0.03
        variances = np.diag(frame.segment.covariance)
        assert sure is None or (variances > sure).all()
        sure = variances
    lost = swim.step(2.4, level_pose(x=1.2))
    assert lost.status.state == State.SEARCHING
    assert lost.status.seconds_since_seen == pytest.approx(1.8)
    assert lost.segment is None
    assert "pipe_not_found" in lost.status.reason
    asked = swim.asked
    assert swim.step(3.0, level_pose(x=1.5)).status.reason == "pipe_not_found"
    assert swim.asked == asked + 1
    swim.diver = seen
    again = swim.step(3.6, level_pose(x=1.8))
    assert again.status.state == State.TRACKING
    assert again.status.seconds_since_seen == 0.0
    assert again.status.reason == ""
    assert again.segment is not None
    assert again.segment.mode == Mode.RECOGNITION
    after = swim.step(4.2, level_pose(x=2.1))
    assert after.segment is not None
    assert after.segment.mode == Mode.TRACKING
    assert after.status.reset_counter == 0


def test_the_way_that_is_coasted_is_bounded_too() -> None:
    swim = Swim(diver(), settings_of(tracking={"max_coast": 0.7, "max_coast_time": 600.0}))
    along(swim, 2)
    swim.lose_pipe()
    states = [swim.step(0.6 * k, level_pose(x=0.3 * k)).status.state for k in range(2, 6)]
    # 0.3 and 0.6 m on from where it was last seen; 0.9 m is too far.
    assert states == [State.COASTING, State.COASTING, State.SEARCHING, State.SEARCHING]


def test_no_coasting_at_all_is_a_setting() -> None:
    swim = Swim(diver(), settings_of(tracking={"max_coast_time": 0.0}))
    along(swim, 2)
    swim.lose_pipe()
    assert swim.step(1.2, level_pose(x=0.6)).status.state == State.SEARCHING


def test_it_follows_again_out_of_coasting() -> None:
    seen = diver(heading=0.1)
    swim = Swim(seen)
    along(swim, 2)
    swim.lose_pipe()
    assert swim.step(1.2, level_pose(x=0.6)).status.state == State.COASTING
    swim.diver = seen
    asked = swim.asked
    back = swim.step(1.8, level_pose(x=0.9))
    assert back.status.state == State.TRACKING
    assert back.segment is not None
    # The prediction was good: there was no need to search.
    assert back.segment.mode == Mode.TRACKING
    assert swim.asked == asked
    assert seen.errors(back.segment, level_pose(x=0.9))[0] < 0.01


def test_a_pipe_that_is_not_where_the_pose_says_is_found_by_the_recognizer() -> None:
    seen = diver()
    swim = Swim(seen)
    along(swim, 2)
    # The pose drifts by 70 cm to the side, no faster than a vehicle may.
    asked = swim.asked
    drifted = swim.step(1.2, level_pose(x=0.6), known=level_pose(x=0.6, y=0.7))
    assert drifted.status.state == State.TRACKING
    assert drifted.segment is not None
    assert drifted.segment.mode == Mode.RECOGNITION
    assert swim.asked == asked + 1
    assert seen.errors(drifted.segment, level_pose(x=0.6))[0] < 0.01
    assert drifted.status.reset_counter == 0


def test_no_answer_of_the_recognizer_is_told() -> None:
    swim = Swim(diver())
    frame = swim.diver.frame(level_pose(), 0)
    assert swim.tracker.begin(frame, level_pose()) is None
    closed = swim.tracker.finish(None, "recognizer_silent")
    assert closed.status.state == State.SEARCHING
    assert closed.status.reason == "recognizer_silent"
    assert closed.status.seconds_since_seen == -1.0
    assert closed.segment is None


# Poses.


def test_without_poses_each_frame_is_recognised_by_itself() -> None:
    seen = diver(heading=0.1)
    swim = Swim(seen)
    for k in range(3):
        pose = level_pose(x=0.3 * k)
        frame = swim.blind(0.6 * k, pose)
        assert swim.asked == k + 1
        assert frame.status.state == State.TRACKING
        assert frame.status.reason == "no_pose"
        assert frame.segment is not None
        assert frame.segment.mode == Mode.RECOGNITION
        assert seen.errors(frame.segment, pose)[0] < 0.01
    swim.lose_pipe()
    frame = swim.blind(1.8, level_pose(x=0.9))
    assert frame.status.state == State.SEARCHING
    assert frame.status.reason == "no_pose, pipe_not_found"
    assert frame.segment is None


def test_a_frame_without_pose_ends_the_track() -> None:
    swim = Swim(diver())
    along(swim, 2)
    assert swim.asked == 1
    swim.blind(1.2, level_pose(x=0.6))
    assert swim.asked == 2
    # The next one with a pose has no past.
    frame = swim.step(1.8, level_pose(x=0.9))
    assert swim.asked == 3
    assert frame.status.reason == ""
    swim.step(2.4, level_pose(x=1.2))
    assert swim.asked == 3


def test_a_lost_frame_without_pose_does_not_coast() -> None:
    swim = Swim(diver())
    along(swim, 2)
    swim.lose_pipe()
    assert swim.blind(1.2, level_pose(x=0.6)).status.state == State.SEARCHING


def test_a_jump_of_the_pose_is_a_reset() -> None:
    seen = diver()
    swim = Swim(seen)
    along(swim, 2)
    jumped = swim.step(1.2, level_pose(x=0.6), known=level_pose(x=50.0))
    assert jumped.status.reset_counter == 1
    assert "pose_jump" in jumped.status.reason
    assert jumped.status.state == State.TRACKING
    assert jumped.segment is not None
    assert jumped.segment.mode == Mode.RECOGNITION
    # Once it is there it goes on from there.
    after = swim.step(1.8, level_pose(x=0.9), known=level_pose(x=50.3))
    assert after.status.reset_counter == 1
    assert after.status.reason == ""
    assert after.segment is not None
    assert after.segment.mode == Mode.TRACKING


def test_a_jump_with_no_pipe_in_view_is_told_too() -> None:
    swim = Swim(diver())
    along(swim, 2)
    swim.lose_pipe()
    jumped = swim.step(1.2, level_pose(x=0.6), known=level_pose(x=50.0))
    assert jumped.status.state == State.SEARCHING
    assert jumped.status.reset_counter == 1
    assert "pose_jump" in jumped.status.reason
    assert jumped.status.seconds_since_seen == -1.0


@pytest.mark.parametrize(("speed", "resets"), [(4.9, 0), (5.1, 1)])
def test_what_a_jump_is_is_a_setting(speed: float, resets: int) -> None:
    swim = Swim(diver(), settings_of(pose={"max_speed": 5.0}))
    swim.lose_pipe()
    swim.step(0.0, level_pose())
    frame = swim.step(2.0, level_pose(), known=level_pose(x=2.0 * speed))
    assert frame.status.reset_counter == resets


def test_jitter_at_a_high_rate_is_no_jump() -> None:
    swim = Swim(diver())
    swim.lose_pipe()
    swim.step(0.0, level_pose())
    assert swim.step(0.01, level_pose(x=0.08)).status.reset_counter == 0
    assert swim.step(0.02, level_pose(x=0.28)).status.reset_counter == 1


def test_a_reset_forgets_and_is_told_in_the_next_frame() -> None:
    swim = Swim(diver())
    along(swim, 2)
    swim.tracker.reset("clock_jump")
    assert swim.tracker.reset_counter == 1
    frame = swim.step(0.1, level_pose(x=0.05))
    assert frame.status.reason == "clock_jump"
    assert frame.status.reset_counter == 1
    assert frame.segment is not None
    assert frame.segment.mode == Mode.RECOGNITION
    assert swim.step(0.2, level_pose(x=0.1)).status.reason == ""
    swim.tracker.reset("clock_jump")
    swim.lose_pipe()
    frame = swim.step(0.3, level_pose(x=0.15))
    assert frame.status.reset_counter == 2
    assert "clock_jump" in frame.status.reason
    assert "pipe_not_found" in frame.status.reason
    assert swim.step(0.4, level_pose(x=0.2)).status.reason == "pipe_not_found"


# Order of calls.


def test_a_frame_is_closed_before_the_next_one() -> None:
    swim = Swim(diver())
    frame = swim.diver.frame(level_pose(), 0)
    with pytest.raises(RuntimeError, match="begin first"):
        swim.tracker.finish(None)
    assert swim.tracker.begin(frame, level_pose()) is None
    with pytest.raises(RuntimeError, match="finish first"):
        swim.tracker.begin(frame, level_pose())
    swim.tracker.reset("clock_jump")
    # A reset drops the open frame.
    assert swim.tracker.begin(frame, level_pose()) is None
    assert swim.tracker.finish(None, "late").status.reason == "clock_jump, late"


def test_recognition_only_tracks_nothing() -> None:
    seen = diver(heading=0.1)
    swim = Swim(seen, recognition_only=True)
    frames = along(swim, 3)
    assert swim.asked == 3
    for frame in frames:
        assert frame.segment is not None
        assert frame.segment.mode == Mode.RECOGNITION
        assert frame.status.state == State.TRACKING
    swim.lose_pipe()
    assert swim.step(1.8, level_pose(x=0.9)).status.state == State.SEARCHING


# Direction of travel.


@pytest.mark.parametrize("yaw", [0.0, 0.5, math.pi - 0.4, -2.0])
def test_start_is_behind_and_end_ahead_whichever_way_the_pipe_is_laid(yaw: float) -> None:
    # Seen by all contours but the right one, as the pipe is laid, of the right image.
    look = replace(LOOK, seen=(0.85, 0.85, 0.85, 0.0), clutter=0)
    seen = diver(look)
    swim = Swim(seen)
    against = abs(yaw) > 0.5 * math.pi
    hidden = Contours.RIGHT_IMAGE_LEFT if against else Contours.RIGHT_IMAGE_RIGHT
    step = 0.3 * np.array([math.cos(yaw), 0.0]) / abs(math.cos(yaw))
    for k in range(4):
        pose = level_pose(x=k * step[0], yaw=yaw)
        frame = swim.step(0.6 * k, pose)
        assert frame.segment is not None
        travel = pose.rotate(frame.segment.end - frame.segment.start)
        assert travel[0] * step[0] > 0.0
        assert frame.segment.visible_contours == ALL & ~hidden
        assert len(frame.segment.contours) == 3
        assert seen.errors(frame.segment, pose)[0] < 0.02
    assert swim.asked == 1


def test_a_vehicle_that_goes_astern_for_good_turns_the_direction() -> None:
    look = replace(LOOK, seen=(0.85, 0.85, 0.85, 0.0), clutter=0)
    swim = Swim(diver(look))
    ahead, bits = [], []
    for k in range(6):
        frame = swim.step(0.6 * k, level_pose(x=-0.3 * k))
        assert frame.segment is not None
        ahead.append(bool((frame.segment.end - frame.segment.start)[0] > 0.0))
        bits.append(frame.segment.visible_contours)
        # Left of travel is where it was measured: the covariance turns with it.
        assert np.linalg.eigvalsh(frame.segment.covariance).min() > 0.0
    # As it looks at first; turned in the third frame that moves against it.
    assert ahead == [True, True, True, False, False, False]
    assert bits[0] == ALL & ~Contours.RIGHT_IMAGE_RIGHT
    assert bits[-1] == ALL & ~Contours.RIGHT_IMAGE_LEFT


def test_a_short_way_astern_turns_nothing() -> None:
    swim = Swim(diver())
    places = (0.0, 0.3, 0.6, 0.5, 0.4, 0.7, 1.0)
    for k, x in enumerate(places):
        frame = swim.step(0.6 * k, level_pose(x=x))
        assert frame.segment is not None
        assert (frame.segment.end - frame.segment.start)[0] > 0.0


def test_what_the_recognizer_finds_is_turned_along_travel_as_well() -> None:
    look = replace(LOOK, seen=(0.85, 0.85, 0.85, 0.0), clutter=0)
    swim = Swim(diver(look, heading=0.2), recognition_only=True)
    frames = [swim.step(0.6 * k, level_pose(x=-0.3 * k), seed=1) for k in range(5)]
    before, after = frames[2].segment, frames[4].segment
    assert before is not None
    assert after is not None
    assert (before.end - before.start)[0] > 0.4
    assert (after.end - after.start)[0] < -0.4
    assert before.visible_contours == ALL & ~Contours.RIGHT_IMAGE_RIGHT
    assert after.visible_contours == ALL & ~Contours.RIGHT_IMAGE_LEFT
    # Against the recognizer's own answer: left and right lines change places, left and pitch signs.
    own = swim.recognizer.recognize(swim.diver.frame(level_pose(x=-1.2), 0, 1))
    assert np.array_equal(own.start, after.end)
    assert np.array_equal(own.end, after.start)
    assert np.array_equal(after.contours, own.contours[[1, 0, 2]])
    signs = np.array([-1.0, 1.0, 1.0, -1.0])
    assert np.allclose(after.covariance, own.covariance * np.outer(signs, signs))
