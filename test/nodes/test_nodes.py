"""The four nodes over DDS, fed by a vehicle that follows a pipe."""

from __future__ import annotations

import math
from array import array
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline_tracker.types import State

pytestmark = pytest.mark.ros


def test_follows_the_pipe_and_gives_one_state_for_each_pair(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    states = [vehicle.drive(k) for k in range(4)]
    assert [s.valid for s in states] == [True] * 4
    assert states[-1].min_distance == pytest.approx(2.0, abs=0.03)
    assert states[-1].heading_misalignment == pytest.approx(0.0, abs=0.03)
    assert states[-1].chainage == pytest.approx(0.6, abs=0.03)
    got, wait = vehicle.talker.got, vehicle.talker.wait
    wait(lambda: len(got["pipeline/markers"]) == 4, "markers")
    wait(lambda: len(got["pipeline/status"]) == 4, "a status of each frame")
    wait(lambda: len(got["pipeline/min_distance"]) == 4, "a distance of each valid frame")
    # The motion is that of a second: known from the third frame on.
    assert [s.motion_observed for s in states] == [False, False, True, True]
    wait(lambda: len(got["pipeline/approach_speed"]) == 2, "a speed where it is known")
    # Recognised once, then tracked.
    assert len(got["pipeline/recognition"]) == 1
    assert [m.mode for m in got["pipeline/segment"]] == [0, 1, 1, 1]
    assert got["pipeline/centerline"][-1].header.frame_id == "odom"
    assert got["pipeline/relative_state"][-1].header.frame_id == "base_link"
    assert got["pipeline/vectorized"][0].header.frame_id == "left_optical"
    assert all(not node.drops for node in live.nodes)


def test_images_without_their_partner_are_counted_and_harmless(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    vehicle.drive(0)
    lonely = vehicle.scene.stamp(1)
    vehicle.send("stereo/left/image_rect", vehicle.image("left", 1, lonely))
    vehicle.send("stereo/right/image_rect", vehicle.image("right", 1, lonely + 50_000_000))
    vehicle.drive(2)
    vehicle.drive(3)
    drops = live.drops("stereo_vectorizer")
    assert drops == {"no_right_image": 1, "no_left_image": 1}
    assert vehicle.status(lonely) is None


def test_a_right_image_within_the_tolerance_is_a_partner(bench: Any) -> None:
    bench.live()
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    for k in range(3):
        stamp = vehicle.scene.stamp(k)
        vehicle.send("vnm/pose", vehicle.pose(k, stamp))
        for side, late in (("left", 0), ("right", 1_500_000)):
            vehicle.send(f"stereo/{side}/camera_info", vehicle.info(side, stamp + late))
            vehicle.send(f"stereo/{side}/image_rect", vehicle.image(side, k, stamp + late))
    first = vehicle.scene.stamp(0)
    state = vehicle.talker.wait(lambda: vehicle.state(first), "the first frame's state")
    assert state.valid


def test_the_first_camera_info_may_come_after_the_first_pair(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    stamp = vehicle.scene.stamp(0)
    vehicle.send("vnm/pose", vehicle.pose(0, stamp))
    for side in ("left", "right"):
        vehicle.send(f"stereo/{side}/image_rect", vehicle.image(side, 0, stamp))
    node = live.node("stereo_vectorizer")
    vehicle.talker.wait(lambda: len(node._without_info) == 1, "the pair waits")
    for side in ("left", "right"):
        vehicle.send(f"stereo/{side}/camera_info", vehicle.info(side, stamp))
    state = vehicle.talker.wait(lambda: vehicle.state(stamp), "its relative state")
    assert state.valid


def test_compressed_images_by_parameter(bench: Any) -> None:
    bench.live("image_transport=compressed")
    vehicle = bench.vehicle()
    kind = "sensor_msgs/msg/CompressedImage"
    for side in ("left", "right"):
        vehicle.talker.close_topic(f"stereo/{side}/image_rect")
        vehicle.talker.publisher(f"stereo/{side}/image_rect/compressed", kind)
    bench.matched(vehicle.talker)
    stamp = vehicle.scene.stamp(0)
    vehicle.send("vnm/pose", vehicle.pose(0, stamp))
    for side, pixels in zip(("left", "right"), vehicle.scene.images(0), strict=True):
        vehicle.send(f"stereo/{side}/camera_info", vehicle.info(side, stamp))
        header = vehicle.info(side, stamp).header
        data = array("B", cv2.imencode(".png", pixels)[1].tobytes())
        message = vehicle.factory.message(kind, header=header, format="png", data=data)
        vehicle.talker.publisher(f"stereo/{side}/image_rect/compressed", kind).publish(message)
    state = vehicle.talker.wait(lambda: vehicle.state(stamp), "its relative state")
    assert state.valid


def test_images_that_are_not_rectified_by_parameter(bench: Any) -> None:
    from pipeline_tracker.nodes.stereo_vectorizer import StereoVectorizer
    from pipeline_tracker.rectification import StereoImages
    from pipeline_tracker.settings_io import load_settings
    from pipeline_tracker.vectorization.vectorizer import Vectorizer

    bench.live("camera.rectify=true", kinds=[StereoVectorizer])
    vehicle = bench.vehicle()
    for side in ("left", "right"):
        vehicle.talker.close_topic(f"stereo/{side}/image_rect")
        vehicle.talker.publisher(f"stereo/{side}/image_raw", "sensor_msgs/msg/Image")
    bench.matched(vehicle.talker)
    stamp = vehicle.scene.stamp(0)
    infos, images = {}, {}
    for side in ("left", "right"):
        infos[side] = vehicle.info(side, stamp)
        infos[side].d = [0.2, 0.04, 0.0, 0.0, 0.0]
        images[side] = vehicle.image(side, 0, stamp)
        vehicle.send(f"stereo/{side}/camera_info", infos[side])
        vehicle.send(f"stereo/{side}/image_raw", images[side])
    got = vehicle.talker.got["pipeline/vectorized"]
    vehicle.talker.wait(lambda: got, "a vectorized pair")
    # The same classes as in a replay give the same.
    settings = load_settings(None, [*vehicle.scene.settings, "camera.rectify=true"])
    read = StereoImages(settings, infos["left"], infos["right"])
    pair = [read.read(images[side], side) for side in ("left", "right")]
    wanted = Vectorizer(settings).process(stamp, read.rig, *pair, read.unseen)
    assert read.unseen.left is not None
    np.testing.assert_array_equal(got[0].left_segments, wanted.left_segments.ravel())
    np.testing.assert_array_equal(got[0].matches, wanted.matches.ravel())
    assert len(wanted.matches) > 100
    assert not any(got[0].left_info.d)
    np.testing.assert_array_equal(got[0].right_info.p, infos["right"].p)


@pytest.mark.parametrize("pose_type", ["pose_with_covariance", "odometry"])
def test_pose_types_by_parameter(bench: Any, pose_type: str) -> None:
    bench.live(f"pose_type={pose_type}")
    vehicle = bench.vehicle()
    kind = {
        "odometry": "nav_msgs/msg/Odometry",
        "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    }[pose_type]
    vehicle.talker.close_topic("vnm/pose")
    vehicle.talker.publisher("vnm/pose", kind)
    bench.matched(vehicle.talker)
    plain = vehicle.pose(0, vehicle.scene.stamp(0))
    message = vehicle.factory.message(kind, header=plain.header)
    message.pose.pose = plain.pose
    vehicle.talker.publisher("vnm/pose", kind).publish(message)
    state = vehicle.drive(0, pose=False)
    assert state.valid
    assert vehicle.status(vehicle.scene.stamp(0)).reason == ""


def test_an_image_waits_for_its_pose_and_takes_the_one_between_two(bench: Any) -> None:
    bench.live("pose.wait=10.0")
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    vehicle.send("vnm/pose", vehicle.pose(-0.5, vehicle.scene.stamp(0) - 250_000_000))
    stamp = vehicle.frame(0, pose=False)
    got = vehicle.talker.got
    vehicle.talker.wait(lambda: got["pipeline/vectorized"], "the frame is vectorized")
    assert vehicle.status(stamp) is None
    vehicle.send("vnm/pose", vehicle.pose(0.5, stamp + 250_000_000))
    vehicle.talker.wait(lambda: vehicle.state(stamp), "its relative state")
    assert vehicle.status(stamp).reason == ""
    # The centreline is drawn where the pose between the two puts it.
    vehicle.talker.wait(lambda: got["pipeline/centerline"], "the centreline")
    point = got["pipeline/centerline"][0].poses[0].pose.position
    assert (point.x, point.y, point.z) == pytest.approx((0.0, 0.0, 0.0), abs=0.03)


def test_without_poses_each_frame_stands_alone(bench: Any) -> None:
    bench.live()
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    for k in range(2):
        state = vehicle.drive(k, pose=False)
        assert state.valid
        assert not state.motion_observed
        assert (state.approach_speed, state.speed_variance) == (0.0, -1.0)
        stamp = vehicle.scene.stamp(k)
        vehicle.talker.wait(lambda stamp=stamp: vehicle.status(stamp), "its status")
        assert vehicle.status(stamp).reason == "no_pose"


def test_a_silent_recognizer_does_not_hold_up_the_frames(bench: Any, monkeypatch: Any) -> None:
    from pipeline_tracker.nodes import frame_flow
    from pipeline_tracker.nodes.live import NODES

    monkeypatch.setattr(frame_flow, "ANSWER_WITHIN", 0.3)
    kinds = [kind for kind in NODES if kind.NAME != "local_recognizer"]
    live, vehicle = bench.live(kinds=kinds), bench.vehicle()
    bench.matched(vehicle.talker)
    got = vehicle.talker.got
    stamps = [vehicle.frame(k) for k in range(2)]
    vehicle.talker.wait(lambda: len(got["pipeline/status"]) == 2, "both statuses")
    for status in got["pipeline/status"]:
        assert status.state == State.SEARCHING
        assert "no answer of the recognizer" in status.reason
    vehicle.talker.wait(lambda: all(vehicle.state(s) for s in stamps), "both states")
    assert not any(vehicle.state(stamp).valid for stamp in stamps)
    assert live.drops("pipe_tracker") == {"recognition_missing": 2}


def test_a_request_may_come_before_its_frame(bench: Any) -> None:
    from pipeline_tracker.messages import header_message, vectorized_message
    from pipeline_tracker.nodes.local_recognizer import LocalRecognizer
    from pipeline_tracker.settings_io import load_settings
    from pipeline_tracker.vectorization.vectorizer import Vectorizer

    bench.live(kinds=[LocalRecognizer])
    talker, scene = bench.talker(), bench.scene
    header, vectorized = "std_msgs/msg/Header", "pipeline_tracker_msgs/msg/VectorizedStereo"
    request = talker.publisher("pipeline/recognition_request", header)
    frames = talker.publisher("pipeline/vectorized", vectorized)
    talker.hear("pipeline/recognition", "pipeline_tracker_msgs/msg/PipeSegment")
    bench.matched(talker)
    from pipeline_tracker.nodes.conversions import LiveMessages

    settings = load_settings(None, list(scene.settings))
    frame = Vectorizer(settings).process(scene.stamp(0), scene.rig, *scene.images(0))
    request.publish(header_message(LiveMessages(), scene.stamp(0), "base_link"))
    frames.publish(vectorized_message(LiveMessages(), frame, "left_optical"))
    got = talker.got["pipeline/recognition"]
    talker.wait(lambda: got, "the answer")
    assert got[0].support > 0.0
    # And once more, the frame being there already.
    request.publish(header_message(LiveMessages(), scene.stamp(0), "base_link"))
    talker.wait(lambda: len(got) == 2, "the second answer")
    assert got[1] == got[0]


def test_namespace_and_remapping(bench: Any) -> None:
    bench.live(namespace="/auv", cli_args=["--ros-args", "-r", "vnm/pose:=/nav/pose"])
    vehicle = bench.vehicle("/auv")
    kind = "geometry_msgs/msg/PoseStamped"
    vehicle.talker._publishers["vnm/pose"] = vehicle.talker.publisher("/nav/pose", kind)
    bench.matched(vehicle.talker)
    state = vehicle.drive(0)
    assert state.valid
    names = {name for name, _ in vehicle.talker.node.get_topic_names_and_types()}
    assert {"/auv/pipeline/relative_state", "/nav/pose"} <= names
    assert not any(name.startswith(("/pipeline/", "/stereo/", "/vnm/")) for name in names)


def test_invalid_within_the_timeout_and_then_each_second(bench: Any) -> None:
    bench.live("output.timeout=0.6")
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    got = vehicle.talker.got["pipeline/relative_state"]
    vehicle.drive(0)
    before = len(got)
    node = vehicle.talker.node
    heard = node.get_clock().now().nanoseconds
    vehicle.talker.wait(lambda: len(got) >= before + 3, "three states of silence")
    silent = got[before:]
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in silent]
    # The present time, not that of a frame; some slack for a busy machine.
    assert abs(stamps[0] - heard * 1e-9) < 0.6 + 0.5
    assert np.diff(stamps) == pytest.approx([1.0, 1.0], abs=0.5)
    for message in silent:
        assert not message.valid
        assert (message.quality, message.heading_variance, message.side) == (0.0, -1.0, 3)
    # It is valid again by itself.
    assert vehicle.drive(1).valid


def test_by_default_silence_is_three_periods_of_the_images(bench: Any) -> None:
    bench.live()
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    got = vehicle.talker.got["pipeline/relative_state"]
    for k in range(3):
        vehicle.drive(k)
    node = vehicle.talker.node
    heard, before = node.get_clock().now().nanoseconds * 1e-9, len(got)
    vehicle.talker.wait(lambda: len(got) > before, "the state of silence")
    stamp = got[before].header.stamp
    silence = stamp.sec + stamp.nanosec * 1e-9 - heard
    # The images are half a second apart; some slack for a busy machine.
    assert 0.7 < silence < 1.5 + 0.5


@pytest.mark.parametrize("simulated", [True, False], ids=["clock", "stamps"])
def test_time_going_backward_is_one_reset_and_the_next_lap_is_like_the_first(
    bench: Any, simulated: bool
) -> None:
    bench.live(*(["use_sim_time=true"] if simulated else []))
    vehicle = bench.vehicle()
    if simulated:
        vehicle.talker.publisher("/clock", "rosgraph_msgs/msg/Clock")
    bench.matched(vehicle.talker)

    def lap() -> list[Any]:
        states = []
        for k in range(4):
            if simulated:
                message = vehicle.factory.message("rosgraph_msgs/msg/Clock")
                stamp = vehicle.scene.stamp(k)
                message.clock.sec, message.clock.nanosec = divmod(stamp, 1_000_000_000)
                vehicle.send("/clock", message)
            stamp, old = vehicle.scene.stamp(k), vehicle.state(vehicle.scene.stamp(k))
            vehicle.frame(k)
            states.append(
                vehicle.talker.wait(
                    lambda stamp=stamp, old=old: (s := vehicle.state(stamp)) is not old and s,
                    f"relative state of frame {k}",
                )
            )
        return states

    first, second = lap(), lap()
    assert {s.reset_counter for s in first} == {0}
    assert {s.reset_counter for s in second} == {1}
    for one, other in zip(first, second, strict=True):
        other.reset_counter = one.reset_counter
        assert one == other
    statuses = [m for m in vehicle.talker.got["pipeline/status"] if m.reset_counter == 1]
    assert statuses[0].reason == "time went backward"


def test_late_and_repeated_frames_have_no_second_status(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    for k in range(2):
        vehicle.drive(k)
    again = vehicle.talker.got["pipeline/vectorized"][0]
    kind = "pipeline_tracker_msgs/msg/VectorizedStereo"
    pirate = vehicle.talker.publisher("pipeline/vectorized", kind)
    bench.matched(vehicle.talker)
    pirate.publish(again)
    vehicle.drive(2)
    assert live.drops("pipe_tracker") == {"frame_late_or_repeated": 1}
    assert len(vehicle.talker.got["pipeline/status"]) == 3


def test_a_camera_calibrated_anew_is_a_reset(bench: Any) -> None:
    bench.live()
    vehicle = bench.vehicle()
    bench.matched(vehicle.talker)
    assert vehicle.drive(0).reset_counter == 0
    info = vehicle.info

    def other(side: str, stamp: int) -> Any:
        message = info(side, stamp)
        message.p[0] *= 1.001
        message.p[3] *= 1.001
        return message

    vehicle.info = other
    assert vehicle.drive(1).reset_counter == 1
    assert vehicle.drive(2).reset_counter == 1


def _garbage(vehicle: Any) -> list[tuple[str, Any]]:
    """Messages that no node may use."""
    stamp = vehicle.scene.stamp(1)
    nan_pose = vehicle.pose(1, stamp)
    nan_pose.pose.position.x = math.nan
    no_rotation = vehicle.pose(1, stamp)
    no_rotation.pose.orientation.w = 0.0
    short = vehicle.image("left", 1, stamp)
    short.data = array("B", [0] * 10)
    odd = vehicle.image("left", 1, stamp + 1)
    odd.encoding = "bayer_rggb8"
    other_size = vehicle.image("left", 1, stamp + 2)
    other_size.width, other_size.height = 100, 100
    empty = vehicle.image("left", 1, stamp + 3)
    empty.width = empty.height = empty.step = 0
    messages = [("vnm/pose", nan_pose), ("vnm/pose", no_rotation)]
    for image in (short, odd, other_size, empty):
        right = vehicle.image("right", 1, stamp)
        right.header = image.header
        messages += [("stereo/left/image_rect", image), ("stereo/right/image_rect", right)]
    return messages


def test_garbage_is_refused_with_words_and_never_ends_a_node(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    vehicle.drive(0)
    for topic, message in _garbage(vehicle):
        vehicle.send(topic, message)
    vectorizer, tracker = live.node("stereo_vectorizer"), live.node("pipe_tracker")
    wait = vehicle.talker.wait
    wait(lambda: vectorizer.drops["pair refused"] == 4, "four pairs are refused")
    wait(lambda: tracker.drops["vnm/pose refused"] == 2, "two poses are refused")
    kinds = {
        "pipeline/vectorized": "pipeline_tracker_msgs/msg/VectorizedStereo",
        "pipeline/segment": "pipeline_tracker_msgs/msg/PipeSegment",
        "pipeline/status": "pipeline_tracker_msgs/msg/TrackingStatus",
        "pipeline/recognition": "pipeline_tracker_msgs/msg/PipeSegment",
    }
    for topic, kind in kinds.items():
        publisher = vehicle.talker.publisher(topic, kind)
        bench.matched(vehicle.talker)
        message = vehicle.factory.message(kind)
        message.header.stamp.sec = 1_700_000_001
        if "status" in topic:
            message.state = 77
        publisher.publish(message)
        # Bytes that are no message at all do not even come through.
        publisher.publish(b"\x00\x01\x00\x00\xff\xff\xff\xff\xff")
    wait(lambda: tracker.drops["pipeline/vectorized refused"] == 1, "an empty frame is refused")
    publisher_node = live.node("relative_state_publisher")
    wait(lambda: publisher_node.drops["pipeline/status refused"] == 1, "a status is refused")
    # Broken calibration: the pair is lost, the next one with a sound one is not.
    broken = vehicle.info("left", vehicle.scene.stamp(2))
    broken.p = np.full(12, math.nan)
    vehicle.send("stereo/left/camera_info", broken)
    stamp = vehicle.scene.stamp(2)
    for side in ("left", "right"):
        vehicle.send(f"stereo/{side}/image_rect", vehicle.image(side, 2, stamp))
    wait(lambda: vectorizer.drops["pair refused"] == 5, "the pair is refused")
    assert vehicle.drive(3).valid
    numbers = [vehicle.state(vehicle.scene.stamp(k)).min_distance for k in (0, 3)]
    assert all(map(math.isfinite, numbers))


def test_quality_of_service_and_its_override(bench: Any) -> None:
    from rclpy.qos import ReliabilityPolicy

    topic = "qos_overrides./stereo/left/image_rect.subscription"
    arguments = ["--ros-args", "-p", f"{topic}.reliability:=reliable", "-p", f"{topic}.depth:=2"]
    bench.live(cli_args=arguments)
    node = bench.vehicle().talker.node

    def offered(topic: str) -> Any:
        return node.get_subscriptions_info_by_topic(topic)

    talker_wait = bench.talker().wait
    for side in ("left", "right"):
        name = f"/stereo/{side}/image_rect"
        talker_wait(lambda name=name: offered(name), f"a subscriber of {name}")
    (left,), (right,) = offered("/stereo/left/image_rect"), offered("/stereo/right/image_rect")
    assert left.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert right.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
