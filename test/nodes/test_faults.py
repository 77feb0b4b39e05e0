"""Faults of time, over DDS: each has the answer that docs/reliability.md tells."""

from __future__ import annotations

import time
from typing import Any

import pytest

pytestmark = pytest.mark.ros

SECOND = 1_000_000_000
OUTPUT = "pipeline/relative_state"


def drive_now(vehicle: Any, k: int, age: float = 0.0) -> Any:
    """Publish frame k with stamps of this machine's clock and wait for its state."""
    vehicle.scene.images(k)  # made before the clock is looked at
    now = time.time_ns() - round(age * SECOND)
    return vehicle.drive(k, shift_ns=now - vehicle.scene.stamp(k))


def test_wrong_stamps_are_dropped_with_a_reason_and_the_pipe_is_followed_on(bench: Any) -> None:
    # A long timeout: here nothing is to be late.
    live, vehicle = bench.live("output.timeout=100.0"), bench.vehicle()
    bench.matched(vehicle.talker)
    assert [drive_now(vehicle, k).valid for k in range(2)] == [True, True]
    last = vehicle.talker.got[OUTPUT][-1].header.stamp
    last_ns = last.sec * SECOND + last.nanosec
    wrong = {
        "without_stamp": 0,
        "of_the_future": time.time_ns() + 3600 * SECOND,
        "stale": time.time_ns() - 30 * SECOND,
        "repeated": last_ns,
    }
    vehicle.scene.images(0)
    for stamp in wrong.values():
        vehicle.send("vnm/pose", vehicle.pose(0, stamp))
        for side in ("left", "right"):
            vehicle.send(f"stereo/{side}/image_rect", vehicle.image(side, 0, stamp))
    state = drive_now(vehicle, 2)
    assert (state.valid, state.reset_counter) == (True, 0)
    assert len(vehicle.talker.got["pipeline/status"]) == 3

    poses = dict.fromkeys(("pose_without_stamp", "pose_of_the_future", "pose_stale"), 1)
    poses["pose_late_or_repeated"] = 1
    for node in ("pipe_tracker", "relative_state_publisher"):
        vehicle.talker.wait(lambda node=node: live.drops(node) == poses, f"{node} tells its drops")
    images = {"repeated": 2}
    for side in ("left", "right"):
        for reason in ("without_stamp", "of_the_future", "stale"):
            images[f"{side}_image_{reason}"] = 1
    assert live.drops("stereo_vectorizer") == images


def test_a_state_that_comes_too_late_is_not_valid(bench: Any) -> None:
    live, vehicle = bench.live("output.timeout=1.0", "image.max_age=60.0"), bench.vehicle()
    bench.matched(vehicle.talker)
    state = drive_now(vehicle, 0, age=1.1)
    assert (state.valid, state.quality) == (False, 0.0)
    assert live.drops("relative_state_publisher") == {"state_too_late": 1}
    # It was tracked all the same: the next one is in time.
    assert not vehicle.talker.got["pipeline/min_distance"]
    assert vehicle.status(
        state.header.stamp.sec * SECOND + state.header.stamp.nanosec
    ).support == pytest.approx(1.0, abs=0.5)


def test_silence_is_told_also_when_simulated_time_has_not_begun_stops_or_jumps_ahead(
    bench: Any,
) -> None:
    bench.live("use_sim_time=true", "output.timeout=0.6")
    vehicle = bench.vehicle()
    clock = vehicle.talker.publisher("/clock", "rosgraph_msgs/msg/Clock")
    bench.matched(vehicle.talker)
    wait, got = vehicle.talker.wait, vehicle.talker.got[OUTPUT]
    # No clock and no message at all.
    wait(lambda: got, "a state before time has begun")
    assert not got[0].valid

    def tick(stamp: int) -> None:
        message = vehicle.factory.message("rosgraph_msgs/msg/Clock")
        message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
        clock.publish(message)

    tick(vehicle.scene.stamp(0))
    assert vehicle.drive(0).valid
    heard, before = time.monotonic(), len(got)
    wait(lambda: len(got) > before, "the state of silence, on a clock that stands still")
    # Some slack for a busy machine.
    assert time.monotonic() - heard < 0.6 + 0.5
    assert not got[before].valid

    ahead = 100 * SECOND
    tick(vehicle.scene.stamp(1) + ahead)
    state = vehicle.drive(1, shift_ns=ahead)
    assert (state.valid, state.reset_counter) == (True, 0)
    # What the vehicle did in between is not known.
    assert not state.motion_observed
