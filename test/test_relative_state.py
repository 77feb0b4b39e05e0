"""The relative state against hand-made cases and searches over sampled points."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.relative_state import RelativeStateEstimator, side_from_contours
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import (
    Contours,
    Mode,
    PipeSegment,
    RelativeState,
    Side,
    State,
    TrackingStatus,
)

Array = NDArray[np.float64]

SECOND = 1_000_000_000
RADIUS = 0.3
SETTINGS = Settings.model_validate({"pipe": {"diameter": 2 * RADIUS}})
MOUNTING = Pose.from_rpy([0.4, 0.1, -0.2], [-math.pi + 0.5, 0.0, -math.pi / 2.0])
COVARIANCE = np.diag([1e-4, 4e-4, 1e-4, 2e-4])


class Sea:
    """A straight pipe in odom, a vehicle that is put somewhere, and an estimator that watches."""

    def __init__(
        self,
        direction: ArrayLike = (1.0, 0.0, 0.0),
        point: ArrayLike = (0.0, 0.0, 0.0),
        settings: Settings = SETTINGS,
    ) -> None:
        self.direction = np.asarray(direction, dtype=np.float64)
        self.direction /= np.linalg.norm(self.direction)
        self.point = np.asarray(point, dtype=np.float64)
        self.estimator = RelativeStateEstimator(settings, MOUNTING)
        self.poses = PoseBuffer(settings.pose.max_gap)
        self.covariance: Array = COVARIANCE
        self.reset_counter = 0

    def segment(self, stamp_ns: int, pose: Pose, ahead: float = 1.0) -> PipeSegment:
        """The piece of the pipe ``ahead`` of the point nearest to base_link."""
        along = float((pose.translation - self.point) @ self.direction) + ahead
        ends = [self.point + (along + e) * self.direction for e in (-0.25, 0.25)]
        start, end = pose.inverse().apply(ends)
        return PipeSegment(
            stamp_ns, Mode.TRACKING, 0, start, end, RADIUS, self.covariance, support=0.8
        )

    def see(
        self,
        time: float,
        pose: Pose | None,
        state: State = State.TRACKING,
        segment: PipeSegment | None = None,
    ) -> RelativeState:
        """Show a frame to the estimator; the segment is the true one unless given."""
        stamp = round(time * SECOND)
        if pose is not None:
            self.poses.add(stamp, pose)
        if segment is None and state != State.SEARCHING:
            assert pose is not None
            segment = self.segment(stamp, pose)
        status = TrackingStatus(stamp, state, "", 0.8, 0.0, self.reset_counter)
        return self.estimator.update(status, segment, self.poses)

    def sail(
        self,
        position: ArrayLike,
        velocity: ArrayLike = (0.5, 0.0, 0.0),
        rpy: ArrayLike = (0.0, 0.0, 0.0),
    ) -> RelativeState:
        """Come to a position at a constant velocity, and look."""
        pose = Pose.from_rpy(position, rpy)
        self.poses.add(0, Pose(pose.rotation, pose.translation - np.asarray(velocity)))
        return self.see(1.0, pose)


def degrees(angle: float) -> float:
    return math.degrees(angle)


# Directions and angles


def test_straight_along_the_pipe_all_angles_are_zero() -> None:
    state = Sea().sail([0.0, 0.0, 2.5])
    assert state.valid
    assert state.motion_observed
    assert state.heading_misalignment == pytest.approx(0.0)
    assert state.pitch_misalignment == pytest.approx(0.0)
    assert state.approach_speed == pytest.approx(0.0)
    assert state.side == Side.ALONG


def test_a_pipe_that_leads_to_port_has_a_positive_heading() -> None:
    turn = math.radians(20.0)
    state = Sea([math.cos(turn), math.sin(turn), 0.0]).sail([0.0, 0.0, 2.5])
    assert degrees(state.heading_misalignment) == pytest.approx(20.0)


def test_heading_is_that_from_the_motion_not_from_the_bow() -> None:
    # The bow along the pipe, the vehicle drifts 10 degrees to starboard: the pipe leads to port.
    drift = math.radians(-10.0)
    velocity = [0.5 * math.cos(drift), 0.5 * math.sin(drift), 0.0]
    state = Sea().sail([0.0, 0.0, 2.5], velocity)
    assert degrees(state.heading_misalignment) == pytest.approx(10.0)
    # Crabbing with the bow 30 degrees off and the motion along the pipe is no misalignment.
    state = Sea().sail([0.0, 0.0, 2.5], rpy=[0.0, 0.0, math.radians(30.0)])
    assert degrees(state.heading_misalignment) == pytest.approx(0.0)


def test_a_climbing_pipe_has_a_positive_pitch() -> None:
    climb = math.radians(10.0)
    state = Sea([math.cos(climb), 0.0, math.sin(climb)]).sail([0.0, 0.0, 2.5])
    assert degrees(state.pitch_misalignment) == pytest.approx(10.0)


def test_a_climbing_vehicle_has_a_negative_pitch() -> None:
    climb = math.radians(10.0)
    state = Sea().sail([0.0, 0.0, 2.5], [0.5 * math.cos(climb), 0.0, 0.5 * math.sin(climb)])
    assert degrees(state.pitch_misalignment) == pytest.approx(-10.0)


def test_the_vehicles_own_attitude_does_not_count() -> None:
    turn = math.radians(30.0)
    sea = Sea([math.cos(turn), math.sin(turn), 0.0])
    rpy = [math.radians(5.0), math.radians(-8.0), 0.0]
    state = sea.sail([0.0, 0.0, 2.5], rpy=rpy)
    # Unlevelled, 5 degrees of roll would turn a heading of 30 degrees into a pitch of 2.5.
    assert degrees(state.heading_misalignment) == pytest.approx(30.0)
    assert degrees(state.pitch_misalignment) == pytest.approx(0.0, abs=1e-9)


# Distances and offsets


@pytest.mark.parametrize("slope", [0.0, 12.0, -35.0])
@pytest.mark.parametrize("position", [[0.2, 1.3, 2.0], [-1.0, -0.8, 3.0]])
def test_distances_and_offsets_against_a_search(slope: float, position: list[float]) -> None:
    climb, turn = math.radians(slope), math.radians(25.0)
    d = [math.cos(climb) * math.cos(turn), math.cos(climb) * math.sin(turn), math.sin(climb)]
    sea = Sea(d)
    rpy = [0.08, -0.12, 0.3]
    state = sea.sail(position, rpy=rpy)
    axis = np.linspace(-8.0, 8.0, 160001)[:, None] * sea.direction
    base = np.array(position)
    camera = Pose.from_rpy(position, rpy).apply(MOUNTING.translation)
    for origin, value in ((base, state.min_distance_base), (camera, state.min_distance)):
        nearest = np.linalg.norm(axis - origin, axis=1).min()
        assert value == pytest.approx(nearest - RADIUS, abs=1e-6)
    across = np.linalg.norm(axis[:, :2] - base[:2], axis=1)
    assert abs(state.lateral_offset) == pytest.approx(across.min(), abs=1e-6)
    assert state.vertical_offset == pytest.approx(base[2] - axis[across.argmin(), 2], abs=1e-3)


def test_to_port_of_the_pipe_is_positive_and_left() -> None:
    state = Sea().sail([0.0, 1.0, 2.5])
    assert state.lateral_offset == pytest.approx(1.0)
    assert state.vertical_offset == pytest.approx(2.5)
    assert state.side == Side.LEFT_OF_PIPE
    state = Sea().sail([0.0, -1.0, 2.5])
    assert state.lateral_offset == pytest.approx(-1.0)
    assert state.side == Side.RIGHT_OF_PIPE


def test_left_is_left_along_travel_whichever_way_it_goes() -> None:
    # Going west, north is to starboard.
    state = Sea().sail([0.0, 1.0, 2.5], [-0.5, 0.0, 0.0], [0.0, 0.0, math.pi])
    assert state.lateral_offset == pytest.approx(-1.0)
    assert state.side == Side.RIGHT_OF_PIPE


def test_side_has_a_hysteresis() -> None:
    sea = Sea()
    sides = []
    for i, radii in enumerate([0.0, 1.2, 1.3, 1.1, 0.9, 1.2, -1.2, -1.3, -1.1, -0.9]):
        sides.append(
            sea.see(float(i), Pose.from_rpy([0.5 * i, RADIUS * radii, 2.0], [0, 0, 0])).side
        )
    along, left, right = Side.ALONG, Side.LEFT_OF_PIPE, Side.RIGHT_OF_PIPE
    assert sides == [along, along, left, left, along, along, along, right, right, along]


def test_side_is_judged_afresh_after_the_pipe_was_lost() -> None:
    sea = Sea()
    above = Pose.from_rpy([0.0, 0.0, 2.0], [0, 0, 0])
    border = Pose.from_rpy([0.0, 1.1 * RADIUS, 2.0], [0, 0, 0])
    assert sea.see(0.0, above).side == Side.ALONG
    assert sea.see(1.0, border).side == Side.ALONG
    assert sea.see(2.0, above, State.SEARCHING).side == Side.NOT_IN_VIEW
    assert sea.see(3.0, border).side == Side.LEFT_OF_PIPE


def test_side_by_the_contours_in_view() -> None:
    left = Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_LEFT
    assert side_from_contours(Contours.NONE) == Side.NOT_IN_VIEW
    assert side_from_contours(left) == Side.LEFT_OF_PIPE
    assert side_from_contours(Contours.RIGHT_IMAGE_RIGHT) == Side.RIGHT_OF_PIPE
    assert side_from_contours(left | Contours.LEFT_IMAGE_RIGHT) == Side.ALONG


def test_contours_without_an_axis_still_tell_the_side() -> None:
    sea = Sea()
    seen = replace(PipeSegment.none(SECOND, RADIUS), visible_contours=Contours.LEFT_IMAGE_RIGHT)
    state = sea.see(1.0, None, State.SEARCHING, seen)
    assert state.side == Side.RIGHT_OF_PIPE
    assert not state.valid


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.1, -0.2, 1.0)])
def test_upper_points_are_the_top_of_the_surface(rpy: tuple[float, float, float]) -> None:
    climb = math.radians(25.0)
    sea = Sea([math.cos(climb), 0.0, math.sin(climb)])
    state = sea.sail([0.0, 0.4, 2.5], rpy=rpy)
    pose = Pose.from_rpy([0.0, 0.4, 2.5], rpy)
    segment = sea.segment(SECOND, pose)
    middle = pose.apply((segment.start + segment.end) / 2.0)
    # Q is the highest point of the circle about C_mid across the axis.
    side = np.array([0.0, 1.0, 0.0])
    angle = np.linspace(0.0, 2.0 * math.pi, 100001)[:, None]
    ring = middle + RADIUS * (np.cos(angle) * side + np.sin(angle) * np.cross(side, sea.direction))
    highest = ring[ring[:, 2].argmax()]
    np.testing.assert_allclose(pose.apply(state.upper_point), highest, atol=1e-4)
    # Q' is straight above C_mid, where a falling weight meets the surface.
    q_vertical = pose.apply(state.upper_point_vertical)
    np.testing.assert_allclose(q_vertical[:2], middle[:2], atol=1e-9)
    assert q_vertical[2] > middle[2]
    off = q_vertical - middle - ((q_vertical - middle) @ sea.direction) * sea.direction
    assert np.linalg.norm(off) == pytest.approx(RADIUS)


# Approach


@pytest.mark.parametrize("velocity", [[0.0, 0.0, -0.3], [0.4, -0.3, 0.1], [-0.2, 0.5, 0.0]])
def test_approach_speed_is_how_fast_the_distance_shrinks(velocity: list[float]) -> None:
    position = np.array([0.0, 1.0, 2.0])
    sea = Sea([1.0, 0.2, 0.1])
    state = sea.sail(position, velocity, rpy=[0.05, 0.1, -0.4])
    axis = np.linspace(-5.0, 5.0, 1000001)[:, None] * sea.direction

    def distance(time: float) -> float:
        return float(np.linalg.norm(axis - position - time * np.array(velocity), axis=1).min())

    shrinking = (distance(-0.01) - distance(0.01)) / 0.02
    assert state.approach_speed == pytest.approx(shrinking, abs=1e-4)


def test_in_the_plane_of_origin_and_axis_the_speed_is_the_papers() -> None:
    sea = Sea([1.0, 0.0, 0.0])
    state = sea.sail([0.0, 0.0, 2.5], [0.4, 0.0, -0.2])
    expected = np.linalg.norm(np.cross([0.4, 0.0, -0.2], sea.direction))
    assert state.approach_speed == pytest.approx(expected)


# Motion


def test_a_pure_descent_has_no_heading_but_an_approach() -> None:
    turn = math.radians(20.0)
    sea = Sea([math.cos(turn), math.sin(turn), 0.0])
    state = sea.sail([0.0, 0.0, 2.5], [0.02, 0.0, -0.2])
    assert not state.motion_observed
    assert degrees(state.heading_misalignment) == pytest.approx(20.0)
    assert state.pitch_misalignment == pytest.approx(0.0)
    assert state.approach_speed == pytest.approx(0.2)
    assert state.speed_variance > 0.0
    assert state.valid


def test_hovering_turned_away_keeps_the_direction() -> None:
    sea = Sea()
    first = sea.sail([0.0, 1.0, 2.5])
    assert first.lateral_offset == pytest.approx(1.0)
    for i in range(10):
        bow = Pose.from_rpy([0.0, 1.0, 2.5], [0.0, 0.0, math.radians(15.0 * i)])
        state = sea.see(3.0 + 2.0 * i, bow)
        assert not state.motion_observed
        assert state.lateral_offset == pytest.approx(1.0)
        assert state.side == Side.LEFT_OF_PIPE
        assert degrees(state.heading_misalignment) == pytest.approx(-15.0 * i)


def test_crossing_does_not_make_the_heading_jump() -> None:
    sea = Sea()
    position = np.array([0.0, -2.0, 2.5])
    sea.see(0.0, Pose.from_rpy(position, [0, 0, 0]))
    seen = []
    for i in range(21):
        course = math.radians(80.0 + i)
        position = position + 0.5 * np.array([math.cos(course), math.sin(course), 0.0])
        state = sea.see(i + 1.0, Pose.from_rpy(position, [0, 0, 0]))
        seen.append(degrees(state.heading_misalignment))
    np.testing.assert_allclose(seen, [-80.0 - i for i in range(21)], atol=1e-6)


def test_astern_turns_the_direction_in_the_third_frame_and_the_chainage_falls() -> None:
    sea = Sea()
    sea.sail([0.0, 1.0, 2.5])
    states = [sea.see(1.0 + i, Pose.from_rpy([-0.3 * i, 1.0, 2.5], [0, 0, 0])) for i in range(1, 7)]
    headings = [round(abs(degrees(s.heading_misalignment))) for s in states]
    assert headings == [180, 180, 0, 0, 0, 0]
    left, right = Side.LEFT_OF_PIPE, Side.RIGHT_OF_PIPE
    assert [s.side for s in states] == [left, left, right, right, right, right]
    assert [round(s.lateral_offset) for s in states] == [1, 1, -1, -1, -1, -1]
    np.testing.assert_allclose([s.chainage for s in states], [-0.3 * i for i in range(1, 7)])


def test_side_keeps_its_hysteresis_when_the_direction_is_turned() -> None:
    sea = Sea()
    aside = 1.1 * RADIUS
    sea.sail([0.0, 1.5 * RADIUS, 2.5])
    sides = [
        sea.see(1.0 + i, Pose.from_rpy([-0.3 * i, aside, 2.5], [0, 0, 0])).side for i in range(1, 5)
    ]
    left, right = Side.LEFT_OF_PIPE, Side.RIGHT_OF_PIPE
    assert sides == [left, left, right, right]


def test_motion_is_that_of_the_window() -> None:
    sea = Sea()
    # 2 m/s at first, then 0.5 m/s to port for exactly the last second.
    for i in range(21):
        time = 0.1 * i
        x, y = (2.0 * time, 0.0) if time <= 1.0 else (2.0, 0.5 * (time - 1.0))
        state = sea.see(time, Pose.from_rpy([x, y, 2.5], [0, 0, 0]))
        assert state.motion_observed == (i >= 10)
    assert degrees(state.heading_misalignment) == pytest.approx(-90.0)


def test_images_further_apart_than_the_window_use_the_previous_image() -> None:
    sea = Sea()
    sea.see(0.0, Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0]))
    # In between it went a long way round: what counts is the way from image to image.
    sea.poses.add(round(1.2 * SECOND), Pose.from_rpy([3.0, 3.0, 2.5], [0, 0, 0]))
    state = sea.see(2.4, Pose.from_rpy([1.0, 0.1, 2.5], [0, 0, 0]))
    assert degrees(state.heading_misalignment) == pytest.approx(-degrees(math.atan2(0.1, 1.0)))
    assert state.motion_observed


def test_poses_between_the_images_are_interpolated() -> None:
    sea = Sea()
    sea.poses.add(0, Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0]))
    state = sea.see(1.5, Pose.from_rpy([1.5, 0.3, 2.5], [0, 0, 0]))
    assert degrees(state.heading_misalignment) == pytest.approx(-degrees(math.atan2(0.2, 1.0)))


def test_across_a_gap_of_the_poses_no_motion_is_made_up() -> None:
    sea = Sea()
    sea.poses.add(0, Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0]))
    state = sea.see(3.5, Pose.from_rpy([1.5, 0.3, 2.5], [0, 0, 0]))
    assert not state.motion_observed
    assert state.approach_speed == 0.0
    assert state.speed_variance == -1.0


# Chainage


def test_chainage_counts_from_the_first_recognition() -> None:
    sea = Sea()
    for i, state in enumerate([State.SEARCHING] * 3 + [State.TRACKING] * 4):
        seen = sea.see(float(i), Pose.from_rpy([0.5 * i, 0.2 * i, 2.5], [0, 0, 0]), state)
        assert seen.chainage == pytest.approx(0.5 * max(0, i - 3))


def test_chainage_is_bridged_over_gaps_and_frames_without_pose() -> None:
    sea = Sea()
    first = Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0])
    sea.see(0.0, first)
    sea.see(1.0, Pose.from_rpy([0.5, 0.0, 2.5], [0, 0, 0]), State.SEARCHING)
    sea.see(2.0, None, State.TRACKING, replace(sea.segment(0, first), stamp_ns=2 * SECOND))
    assert sea.see(7.0, Pose.from_rpy([4.0, 1.0, 2.5], [0, 0, 0])).chainage == pytest.approx(4.0)


def test_chainage_on_an_arc_is_its_length() -> None:
    sea = Sea()
    bend, step = 20.0, 0.5
    for i in range(40):
        angle = i * step / bend
        sea.direction = np.array([math.cos(angle), math.sin(angle), 0.0])
        sea.point = bend * np.array([math.sin(angle), 1.0 - math.cos(angle), 0.0])
        position = sea.point + np.array([0.0, 0.0, 2.5])
        seen = sea.see(float(i), Pose.from_rpy(position, [0.0, 0.0, angle]))
        # The chords are what is summed; they are shorter by the square of the step.
        assert seen.chainage == pytest.approx(i * step, rel=step**2 / bend**2 / 20.0)


def test_the_reference_point_can_be_set() -> None:
    sea = Sea()
    for i in range(3):
        sea.see(float(i), Pose.from_rpy([0.5 * i, 0.0, 2.5], [0, 0, 0]))
    sea.see(3.0, Pose.from_rpy([1.5, 0.0, 2.5], [0, 0, 0]), State.SEARCHING)
    sea.estimator.set_reference()
    assert sea.see(4.0, Pose.from_rpy([2.0, 0.0, 2.5], [0, 0, 0])).chainage == pytest.approx(0.5)


def test_a_reference_set_before_anything_is_the_first_recognition() -> None:
    sea = Sea()
    sea.estimator.set_reference()
    assert sea.see(0.0, Pose.from_rpy([7.0, 0.0, 2.5], [0, 0, 0])).chainage == 0.0


# States


def test_searching_has_no_numbers() -> None:
    sea = Sea()
    sea.sail([0.0, 0.0, 2.5])
    state = sea.see(2.0, Pose.from_rpy([0.5, 0.0, 2.5], [0, 0, 0]), State.SEARCHING)
    empty = RelativeState(2 * SECOND, False, 0.0, 0)
    for field in fields(RelativeState):
        np.testing.assert_array_equal(getattr(state, field.name), getattr(empty, field.name))
    assert state.side == Side.NOT_IN_VIEW
    assert state.heading_variance == state.distance_variance == -1.0


def test_coasting_is_filled_but_not_valid() -> None:
    tracked = Sea().sail([0.0, 1.0, 2.5])
    sea = Sea()
    sea.poses.add(0, Pose.from_rpy([-0.5, 1.0, 2.5], [0, 0, 0]))
    coasted = sea.see(1.0, Pose.from_rpy([0.0, 1.0, 2.5], [0, 0, 0]), State.COASTING)
    assert not coasted.valid
    assert coasted.quality == 0.0
    for name in ("lateral_offset", "min_distance", "heading_variance", "speed_variance", "side"):
        assert getattr(coasted, name) == getattr(tracked, name)


def test_quality_is_the_support_as_float32() -> None:
    sea = Sea()
    pose = Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0])
    segment = replace(sea.segment(0, pose), support=float(np.float32(0.7)))
    assert sea.see(0.0, pose, segment=segment).quality == float(np.float32(0.7))


def test_without_poses_a_frame_stands_by_itself() -> None:
    sea = Sea([-1.0, -0.3, 0.2])
    level = Pose.from_rpy([0.0, 1.0, 2.5], [0, 0, 0])
    state = sea.see(1.0, None, State.TRACKING, sea.segment(SECOND, level))
    assert state.valid
    assert not state.motion_observed
    assert degrees(state.heading_misalignment) == pytest.approx(degrees(math.atan2(0.3, 1.0)))
    assert state.pitch_misalignment == pytest.approx(-math.atan2(0.2, math.hypot(1.0, 0.3)))
    assert state.lateral_offset > 0.0
    assert state.approach_speed == state.chainage == 0.0
    assert state.speed_variance == -1.0
    assert state.heading_variance == pytest.approx(COVARIANCE[2, 2])
    # Nor does it leave a direction behind for the next one.
    state = sea.see(
        2.0,
        None,
        State.TRACKING,
        replace(
            sea.segment(SECOND, Pose.from_rpy([0.0, 1.0, 2.5], [0, 0, math.pi])),
            stamp_ns=2 * SECOND,
        ),
    )
    assert abs(degrees(state.heading_misalignment)) < 90.0


def test_a_new_reset_counter_forgets_the_past() -> None:
    sea = Sea()
    for i in range(3):
        sea.see(float(i), Pose.from_rpy([0.5 * i, 1.0, 2.5], [0, 0, 0]))
    sea.reset_counter = 1
    sea.poses.clear()
    state = sea.see(3.0, Pose.from_rpy([1.5, 1.0, 2.5], [0, 0, math.pi]))
    assert state.reset_counter == 1
    assert state.chainage == 0.0
    assert not state.motion_observed
    # The direction is chosen anew, by the bow.
    assert state.lateral_offset == pytest.approx(-1.0)
    assert sea.see(4.0, Pose.from_rpy([1.0, 1.0, 2.5], [0, 0, math.pi])).chainage == pytest.approx(
        0.5
    )


def test_a_camera_inside_the_pipe_is_not_valid() -> None:
    sea = Sea()
    state = sea.sail([0.0, -0.1, 0.3])
    assert state.min_distance < 0.0
    assert not state.valid
    assert state.quality == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_segment_that_is_not_finite_is_no_pipe(bad: float) -> None:
    sea = Sea()
    pose = Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0])
    segment = replace(sea.segment(0, pose), end=np.array([1.0, bad, 0.0]))
    state = sea.see(0.0, pose, segment=segment)
    assert not state.valid
    assert state.side == Side.NOT_IN_VIEW


def test_a_segment_without_length_is_no_pipe() -> None:
    sea = Sea()
    pose = Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0])
    segment = sea.segment(0, pose)
    assert not sea.see(0.0, pose, segment=replace(segment, end=segment.start)).valid


def test_a_vertical_pipe_says_what_is_undefined() -> None:
    sea = Sea([0.01, 0.0, 1.0])
    state = sea.sail([2.0, 0.0, 2.5], [0.3, 0.0, 0.0])
    assert state.valid
    assert state.heading_misalignment == state.lateral_offset == 0.0
    assert state.heading_variance == -1.0
    np.testing.assert_array_equal(state.upper_point, np.zeros(3))
    np.testing.assert_array_equal(state.upper_point_vertical, np.zeros(3))
    assert degrees(state.pitch_misalignment) == pytest.approx(90.0, abs=1.0)
    assert state.min_distance_base == pytest.approx(2.0 - RADIUS, abs=0.05)
    assert state.approach_speed == pytest.approx(-0.3, abs=0.01)


def test_base_link_on_the_axis_has_no_approach() -> None:
    state = Sea().sail([0.0, 0.0, 0.0])
    assert state.approach_speed == 0.0
    assert state.speed_variance == -1.0


def test_status_and_segment_of_different_frames_are_refused() -> None:
    sea = Sea()
    pose = Pose.from_rpy([0.0, 0.0, 2.5], [0, 0, 0])
    with pytest.raises(ValueError, match="expected the same frame"):
        sea.see(1.0, pose, segment=sea.segment(5, pose))
