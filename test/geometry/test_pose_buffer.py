"""The pose buffer: what it answers, and what it refuses to guess."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer

SECOND = 1_000_000_000


def at_x(x: float, yaw: float = 0.0) -> Pose:
    return Pose.from_rpy([x, 0.0, 0.0], [0.0, 0.0, yaw])


def test_an_equal_stamp_gives_the_pose_as_it_came() -> None:
    buffer = PoseBuffer(max_gap=0.0)
    pose = at_x(1.0)
    assert buffer.add(5, pose)
    assert buffer.at(5) is pose


def test_between_two_poses_it_interpolates() -> None:
    buffer = PoseBuffer(max_gap=2.0)
    buffer.add(0, at_x(0.0))
    buffer.add(2 * SECOND, at_x(4.0, yaw=0.4))
    pose = buffer.at(SECOND // 2)
    assert pose is not None
    np.testing.assert_allclose(pose.translation, [1.0, 0.0, 0.0])
    assert math.atan2(pose.rotation[1, 0], pose.rotation[0, 0]) == pytest.approx(0.1)


def test_it_never_extrapolates() -> None:
    buffer = PoseBuffer(max_gap=3.0)
    assert buffer.at(0) is None
    buffer.add(10, at_x(0.0))
    buffer.add(20, at_x(1.0))
    assert buffer.at(9) is None
    assert buffer.at(21) is None


def test_a_wide_gap_is_not_bridged_but_its_ends_are_known() -> None:
    buffer = PoseBuffer(max_gap=1.0)
    buffer.add(0, at_x(0.0))
    buffer.add(SECOND, at_x(1.0))
    buffer.add(2 * SECOND + 1, at_x(2.0))
    assert buffer.at(SECOND // 2) is not None
    assert buffer.at(SECOND + SECOND // 2) is None
    assert buffer.at(2 * SECOND + 1) is not None


def test_repeated_and_late_poses_are_dropped() -> None:
    buffer = PoseBuffer(max_gap=1.0)
    assert buffer.add(100, at_x(1.0))
    assert not buffer.add(100, at_x(2.0))
    assert not buffer.add(99, at_x(3.0))
    assert len(buffer) == 1
    pose = buffer.at(100)
    assert pose is not None
    assert pose.translation[0] == 1.0


def test_settled_once_a_pose_at_or_after_the_stamp_is_there() -> None:
    buffer = PoseBuffer(max_gap=1.0)
    assert not buffer.settled(10)
    buffer.add(9, at_x(0.0))
    assert not buffer.settled(10)
    buffer.add(10, at_x(0.0))
    assert buffer.settled(10)
    assert not buffer.settled(11)


def test_clear_forgets_and_lets_time_go_back() -> None:
    buffer = PoseBuffer(max_gap=1.0)
    buffer.add(100, at_x(1.0))
    buffer.clear()
    assert buffer.at(100) is None
    assert not buffer.settled(0)
    assert buffer.add(50, at_x(0.5))


def test_memory_is_bounded_and_history_is_kept_so_long() -> None:
    buffer = PoseBuffer(max_gap=1.0, keep=2.0)
    for i in range(1000):
        buffer.add(i * SECOND // 10, at_x(float(i)))
    assert len(buffer) == 21
    newest = 999 * SECOND // 10
    assert buffer.at(newest - 2 * SECOND) is not None
    assert buffer.at(newest - 2 * SECOND - 1) is None


@pytest.mark.parametrize(("max_gap", "keep"), [(-1.0, 30.0), (math.nan, 30.0), (1.0, 0.0)])
def test_impossible_times_are_refused(max_gap: float, keep: float) -> None:
    with pytest.raises(ValueError, match="max_gap"):
        PoseBuffer(max_gap, keep)


@given(
    st.lists(st.integers(0, 10 * SECOND), min_size=2, max_size=30, unique=True),
    st.integers(0, 10 * SECOND),
)
def test_it_agrees_with_a_linear_search(stamps: list[int], wanted: int) -> None:
    stamps.sort()
    buffer = PoseBuffer(max_gap=1.0)
    for stamp in stamps:
        buffer.add(stamp, at_x(stamp / SECOND))
    pose = buffer.at(wanted)
    known = wanted in stamps or any(a < wanted < b and b - a <= SECOND for a, b in pairwise(stamps))
    assert (pose is not None) == known
    if pose is not None:
        # x grows evenly with time, so that any right interpolation gives the time itself.
        assert pose.translation[0] == pytest.approx(wanted / SECOND, abs=1e-9)
