"""What moving, turning and mirroring the world does to the relative state; its variances."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.relative_state.motion import DRIFT_SHARE, END_SIGMA
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import Mode, PipeSegment, RelativeState, Side, State, TrackingStatus

Array = NDArray[np.float64]

SECOND = 1_000_000_000
MOUNTING = Pose.from_rpy([0.4, 0.1, -0.2], [-math.pi + 0.5, 0.0, -math.pi / 2.0])
MIRROR = np.diag([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Scene:
    """Poses one second apart, and the segment seen in each but the first, in odom."""

    poses: list[Pose]
    middle: Array
    direction: Array
    covariance: Array
    radius: float = 0.3
    mounting: Pose = MOUNTING

    def segment(self, index: int, turned: bool = False) -> PipeSegment:
        ends = [self.middle + t * self.direction for t in (-0.25, 0.25)]
        start, end = self.poses[index].inverse().apply(ends[::-1] if turned else ends)
        signs = np.array([-1.0, 1.0, 1.0, -1.0]) if turned else np.ones(4)
        return PipeSegment(
            index * SECOND,
            Mode.TRACKING,
            0,
            start,
            end,
            self.radius,
            self.covariance * np.outer(signs, signs),
            support=0.8,
        )

    def states(self, turned: bool = False) -> list[RelativeState]:
        """Run the estimator over all frames."""
        settings = Settings.model_validate({"pipe": {"diameter": 2.0 * self.radius}})
        estimator = RelativeStateEstimator(settings, self.mounting)
        buffer = PoseBuffer(settings.pose.max_gap)
        result = []
        for index, pose in enumerate(self.poses):
            buffer.add(index * SECOND, pose)
            status = TrackingStatus(index * SECOND, State.TRACKING, "", 0.8, 0.0, 0)
            result.append(estimator.update(status, self.segment(index, turned), buffer))
        return result


def unit(azimuth: float, slope: float) -> Array:
    return np.array(
        [
            math.cos(azimuth) * math.cos(slope),
            math.sin(azimuth) * math.cos(slope),
            math.sin(slope),
        ]
    )


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    def number(low: float, high: float) -> float:
        return draw(st.floats(low, high))

    velocity = number(0.0, 1.0) * unit(number(-3.1, 3.1), number(-0.5, 0.5))
    # Near the least speed and at right angles to the pipe, rounding would decide.
    assume(abs(np.hypot(velocity[0], velocity[1]) - 0.05) > 1e-3)
    yaw = number(-3.1, 3.1)
    poses = [
        Pose.from_rpy(
            np.array([0.0, 0.0, 3.0]) + i * velocity,
            [number(-0.3, 0.3), number(-0.3, 0.3), yaw + number(-0.2, 0.2)],
        )
        for i in range(3)
    ]
    direction = unit(number(-3.1, 3.1), number(-0.6, 0.6))
    assume(abs(direction @ velocity) > 1e-3 or np.linalg.norm(velocity) < 0.01)
    assume(all(abs(direction @ p.rotation[:, 0]) > 1e-2 for p in poses))
    root = np.array([[number(-0.02, 0.02) for _ in range(4)] for _ in range(4)])
    return Scene(
        poses,
        np.array([number(-2.0, 2.0), number(-2.0, 2.0), number(-0.5, 0.5)]),
        direction,
        root @ root.T + 1e-4 * np.eye(4),
    )


def assert_same(first: RelativeState, second: RelativeState, *changed: str) -> None:
    for field in fields(RelativeState):
        if field.name in changed:
            continue
        a, b = getattr(first, field.name), getattr(second, field.name)
        if field.name == "heading_misalignment":
            assert math.cos(a - b) == pytest.approx(1.0, abs=1e-12)
        else:
            np.testing.assert_allclose(a, b, atol=1e-7, err_msg=field.name)


@given(scenes(), st.tuples(*[st.floats(-100, 100)] * 3), st.floats(-3.1, 3.1))
def test_moving_and_turning_the_world_changes_nothing(
    scene: Scene, way: tuple[float, float, float], turn: float
) -> None:
    move = Pose.from_rpy(way, [0.0, 0.0, turn])
    moved = replace(
        scene,
        poses=[move @ p for p in scene.poses],
        middle=move.apply(scene.middle),
        direction=move.rotate(scene.direction),
    )
    for first, second in zip(scene.states(), moved.states(), strict=True):
        assert_same(first, second)


@given(scenes())
def test_a_segment_turned_end_for_end_changes_nothing(scene: Scene) -> None:
    for first, second in zip(scene.states(), scene.states(turned=True), strict=True):
        assert_same(first, second)


@given(scenes())
def test_in_the_mirror_heading_and_side_change_and_the_rest_stays(scene: Scene) -> None:
    signs = np.array([-1.0, 1.0, -1.0, 1.0])

    def reflect(pose: Pose) -> Pose:
        return Pose(MIRROR @ pose.rotation @ MIRROR, MIRROR @ pose.translation)

    mirrored = replace(
        scene,
        poses=[reflect(p) for p in scene.poses],
        middle=MIRROR @ scene.middle,
        direction=MIRROR @ scene.direction,
        covariance=scene.covariance * np.outer(signs, signs),
        mounting=reflect(scene.mounting),
    )
    other = {
        Side.LEFT_OF_PIPE: Side.RIGHT_OF_PIPE,
        Side.RIGHT_OF_PIPE: Side.LEFT_OF_PIPE,
        Side.ALONG: Side.ALONG,
    }
    for first, second in zip(scene.states(), mirrored.states(), strict=True):
        back = replace(
            second,
            heading_misalignment=-second.heading_misalignment,
            lateral_offset=-second.lateral_offset,
            side=other[second.side],
            upper_point=MIRROR @ second.upper_point,
            upper_point_vertical=MIRROR @ second.upper_point_vertical,
        )
        assert_same(first, back)


@given(scenes())
def test_every_number_is_finite_and_the_bounds_hold(scene: Scene) -> None:
    for state in scene.states():
        for field in fields(RelativeState):
            assert np.isfinite(getattr(state, field.name)).all(), field.name
        velocity = scene.poses[1].translation - scene.poses[0].translation
        across = np.linalg.norm(np.cross(velocity, scene.direction))
        assert abs(state.approach_speed) <= across + 1e-9
        assert abs(state.lateral_offset) <= state.min_distance_base + scene.radius + 1e-9


@given(scenes())
def test_variances_are_those_of_small_displacements_of_the_axis(scene: Scene) -> None:
    """The gradients by differences: the segment itself is moved and turned in the world."""
    left = np.cross([0.0, 0.0, 1.0], scene.direction)
    left /= np.linalg.norm(left)
    up = np.cross(scene.direction, left)
    azimuth = math.atan2(scene.direction[1], scene.direction[0])
    slope = math.asin(scene.direction[2])
    step = 1e-5

    def moved(index: int, amount: float) -> RelativeState:
        a = np.zeros(4)
        a[index] = amount
        return replace(
            scene,
            middle=scene.middle + a[0] * left + a[1] * up,
            direction=unit(azimuth + a[2], slope + a[3]),
        ).states()[-1]

    state = scene.states()[-1]
    assume(state.min_distance > 0.0 and state.min_distance_base > 0.0)
    pairs = [(moved(i, step), moved(i, -step)) for i in range(4)]
    # The line means the same whichever way round D is; its covariance is given for `direction`.
    to_distance = np.array([(p.min_distance - m.min_distance) / (2 * step) for p, m in pairs])
    expected = to_distance @ scene.covariance @ to_distance
    assert state.distance_variance == pytest.approx(expected, rel=1e-4, abs=1e-10)

    to_speed = np.array([(p.approach_speed - m.approach_speed) / (2 * step) for p, m in pairs])
    way = float(np.linalg.norm(scene.poses[2].translation - scene.poses[1].translation))
    of_motion = END_SIGMA**2 + (DRIFT_SHARE * way) ** 2
    expected = to_speed @ scene.covariance @ to_speed + of_motion
    assert state.speed_variance == pytest.approx(expected, rel=1e-4, abs=1e-10)


def test_variance_of_the_angles_covers_a_noisy_motion() -> None:
    scene = Scene(
        [Pose.from_rpy([0.0, 0.0, 3.0], [0, 0, 0]), Pose.from_rpy([0.3, 0.0, 3.0], [0, 0, 0])],
        np.zeros(3),
        unit(0.2, 0.1),
        np.diag([1e-4, 1e-4, 1e-12, 1e-12]),
    )
    rng = np.random.default_rng(1)
    sigma = math.hypot(END_SIGMA, DRIFT_SHARE * 0.3)
    noisy = []
    for _ in range(1500):
        first = Pose(np.eye(3), scene.poses[0].translation + rng.normal(0.0, sigma, 3))
        noisy.append(replace(scene, poses=[first, scene.poses[1]]).states()[-1])
    state = scene.states()[-1]
    headings = np.var([s.heading_misalignment for s in noisy])
    pitches = np.var([s.pitch_misalignment for s in noisy])
    # 1500 draws give a variance to 4 %; 15 % is four sigma.
    assert state.heading_variance == pytest.approx(headings, rel=0.15)
    assert state.pitch_variance == pytest.approx(pitches, rel=0.15)


def test_an_unknown_covariance_leaves_the_variances_unknown() -> None:
    scene = Scene(
        [Pose.from_rpy([0.0, 0.0, 3.0], [0, 0, 0]), Pose.from_rpy([0.3, 0.0, 3.0], [0, 0, 0])],
        np.zeros(3),
        unit(0.2, 0.1),
        np.zeros((4, 4)),
    )
    state = scene.states()[-1]
    assert state.heading_variance == state.pitch_variance == state.distance_variance == -1.0
    # The speed is known, so that its variance may not be -1: it is what the motion gives.
    assert state.speed_variance > 0.0
