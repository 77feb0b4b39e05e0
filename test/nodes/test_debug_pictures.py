"""Live pictures: drawn while someone looks, of the frames that there are, and never in the way."""

from __future__ import annotations

import threading
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline_tracker.messages import stamp_ns
from pipeline_tracker.report.overlay import _LEFT_CONTOUR, _RIGHT_CONTOUR

pytestmark = pytest.mark.ros

TOPIC, KIND = "pipeline/debug/image/compressed", "sensor_msgs/msg/CompressedImage"
ANSWERS = {"/pipeline/segment", "/pipeline/status", "/pipeline/relative_state"}


def heard_by(node: Any) -> set[str]:
    return {subscription.topic_name for subscription in node.subscriptions}


def looking(bench: Any, live: Any, vehicle: Any) -> Any:
    """Begin to look; return when the pictures' inputs are open."""
    vehicle.talker.hear(TOPIC, KIND)
    node = live.node("stereo_vectorizer")
    vehicle.talker.wait(lambda: heard_by(node) >= ANSWERS, "the inputs of the pictures")
    bench.matched(vehicle.talker)
    return node


def picture_of(vehicle: Any, stamp: int) -> np.ndarray[Any, Any]:
    """Wait for the picture of a frame."""

    def found() -> Any:
        got = vehicle.talker.got[TOPIC]
        return next((m for m in got if stamp_ns(m.header) == stamp), None)

    message = vehicle.talker.wait(found, "the picture")
    assert (message.format, message.header.frame_id) == ("jpeg", "left_optical")
    return cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)


def has(picture: np.ndarray[Any, Any], colour: tuple[int, int, int]) -> bool:
    return int((np.abs(picture.astype(int) - colour).max(axis=2) < 40).sum()) > 200


def test_nothing_is_done_while_nobody_looks(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    vehicle.drive(0)
    node = live.node("stereo_vectorizer")
    assert not heard_by(node) & ANSWERS
    assert not node._pictures._kept


def test_pictures_show_what_was_found_in_both_images(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    looking(bench, live, vehicle)
    for k in range(2):
        vehicle.drive(k)
    for k in range(2):
        picture = picture_of(vehicle, vehicle.scene.stamp(k))
        assert picture.shape == (480, 1280, 3)
        for half in (picture[:, :640], picture[:, 640:]):
            assert has(half, _LEFT_CONTOUR)
            assert has(half, _RIGHT_CONTOUR)
    assert all(not node.drops for node in live.nodes)


def test_a_frame_without_a_pipe_has_its_picture_too(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    looking(bench, live, vehicle)
    grey = np.full((576, 768), 90, np.uint8)
    stamp = vehicle.scene.stamp(0)
    for side in ("left", "right"):
        vehicle.send(f"stereo/{side}/camera_info", vehicle.info(side, stamp))
        message = vehicle.image(side, 0, stamp)
        message.data = vehicle.factory.sequence(grey.ravel())
        vehicle.send(f"stereo/{side}/image_rect", message)
    picture = picture_of(vehicle, stamp)
    assert not has(picture, _LEFT_CONTOUR)
    assert (picture[:60, :300] > 200).any(), "the state in words"


def test_all_ends_when_nobody_looks_any_more_and_begins_again(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    node = looking(bench, live, vehicle)
    vehicle.drive(0)
    picture_of(vehicle, vehicle.scene.stamp(0))
    talker = vehicle.talker.node
    (heard,) = (s for s in talker.subscriptions if s.topic_name == f"/{TOPIC}")
    talker.destroy_subscription(heard)
    vehicle.talker.wait(lambda: not heard_by(node) & ANSWERS, "the inputs to be closed")
    vehicle.drive(1)
    assert not node._pictures._kept
    looking(bench, live, vehicle)
    vehicle.drive(2)
    picture_of(vehicle, vehicle.scene.stamp(2))


def test_pictures_never_hold_up_the_nodes(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pipeline_tracker.nodes import debug_pictures

    draw, gate, drawn = debug_pictures.draw_overlay, threading.Event(), []

    def slow(left: Any, right: Any, result: Any, *arguments: Any, **options: Any) -> Any:
        drawn.append(result.relative_state.stamp_ns)
        assert gate.wait(60.0)
        return draw(left, right, result, *arguments, **options)

    monkeypatch.setattr(debug_pictures, "draw_overlay", slow)
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    node = looking(bench, live, vehicle)
    # The first picture is never done, and still each frame has its state.
    for k in range(5):
        assert vehicle.drive(k).valid
    stamps = [vehicle.scene.stamp(k) for k in range(5)]
    vehicle.talker.wait(lambda: not node._pictures._kept, "all frames given to be drawn")
    assert drawn == stamps[:1]
    gate.set()
    picture_of(vehicle, stamps[4])
    assert drawn == [stamps[0], stamps[4]], "those between were dropped"


def test_a_picture_that_fails_is_counted_and_harmless(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline_tracker.nodes import debug_pictures

    def fail(*_: Any, **__: Any) -> Any:
        raise RuntimeError("no paint")

    monkeypatch.setattr(debug_pictures, "draw_overlay", fail)
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    node = looking(bench, live, vehicle)
    assert vehicle.drive(0).valid
    vehicle.talker.wait(lambda: node.drops["picture failed"] == 1, "the failure to be counted")
    assert vehicle.drive(1).valid


def test_layouts_show_topics_that_the_nodes_publish(bench: Any) -> None:
    """The names of ``test_views`` are those of live nodes; images and poses come from outside."""
    from pipeline_tracker.replay.result_bag import TOPICS

    live = bench.live()
    published = {p.topic_name for node in live.nodes for p in node.publishers}
    assert published >= {*TOPICS, f"/{TOPIC}"}
