"""Foxglove and RViz: what their layouts show is in a result bag, or published by the nodes."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from bag_maker import FRAME, HEIGHT, LEFT, MOUNTING, WIDTH, Sea, mcap_of, write_bag
from mcap.reader import make_reader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from stand_in import StandIn

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.typestore import our_typestore
from pipeline_tracker.camera_info import camera_from_info
from pipeline_tracker.messages import (
    pose_from_message,
    stamp_ns,
    transform_from_message,
)
from pipeline_tracker.replay import replay
from pipeline_tracker.replay.result_bag import EXTRA_TOPICS, LEFT_IMAGE, TOPICS
from pipeline_tracker.report.overlay import _LEFT_CONTOUR
from pipeline_tracker.resources import config_path
from pipeline_tracker.settings_io import settings_from_values

# Published by the nodes alone.
LIVE = {"/pipeline/debug/image/compressed": "sensor_msgs/msg/CompressedImage"}
KNOWN = {**TOPICS, **EXTRA_TOPICS, **LIVE, LEFT_IMAGE: "sensor_msgs/msg/CompressedImage"}
IMAGES = {"sensor_msgs/msg/CompressedImage"}
IN_3D = {
    "visualization_msgs/msg/MarkerArray",
    "nav_msgs/msg/Path",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/CameraInfo",
}
SEA = Sea(frames=5, level=lambda i: 50 if i == 2 else 150)


def replayed(place: Path, **settings: object) -> Path:
    bag = write_bag(place / "bag", SEA.items())
    values = settings_from_values({"pipe.diameter": 0.6, **settings})
    done = replay(bag, values, place / "out", stream=io.StringIO(), make_pipeline=StandIn)
    return done.output / "result"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def messages(result: Path) -> dict[str, list[Any]]:
    with BagReader(result) as bag:
        return {name: [r.unpack() for r in bag.records([name])] for name in bag.topics}


# The result bag.


def test_types_are_as_foxglove_knows_them(result: Path) -> None:
    with BagReader(result) as bag:
        found = {name: topic.type_name for name, topic in bag.topics.items()}
    assert found == {name: kind for name, kind in KNOWN.items() if name not in LIVE}


def test_annotations_can_be_read_by_the_definition_in_the_bag_alone(result: Path) -> None:
    store = get_typestore(Stores.EMPTY)
    count = 0
    with mcap_of(result).open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic != "/pipeline/debug/left/annotations":
                continue
            assert (schema.name, schema.encoding) == (
                "foxglove_msgs/msg/ImageAnnotations",
                "ros2msg",
            )
            if not count:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            read = store.deserialize_cdr(message.data, schema.name)
            assert (len(read.circles), len(read.texts) > 0) == (0, True)
            count += 1
    assert count == SEA.frames


def test_annotations_are_where_the_contours_are(messages: dict[str, list[Any]]) -> None:
    drawn = messages["/pipeline/debug/left/annotations"]
    assert len(drawn) == SEA.frames
    first = drawn[0]
    stamps = {a.timestamp.sec * 10**9 + a.timestamp.nanosec for a in (*first.points, *first.texts)}
    assert stamps == {SEA.stamp(0)}, "Foxglove puts image and annotations together by it"
    strips = [a for a in first.points if a.type == a.LINE_STRIP]
    b, g, r = _LEFT_CONTOUR
    (left,) = (
        a
        for a in strips
        if (a.outline_color.r, a.outline_color.g) == pytest.approx((r / 255, g / 255), abs=1e-3)
        and a.outline_color.b == pytest.approx(b / 255, abs=1e-3)
    )
    # Pixel 10 has its centre half a pixel from the corner that Foxglove counts from.
    assert [(p.x, p.y) for p in left.points] == [(10.5, 0.5), (10.5, 47.5)]
    assert left.outline_color.a == 1.0
    assert first.texts[0].text == "tracking"
    assert any(text.text.startswith("distance 1.700 m") for text in first.texts)
    lost = drawn[2]
    assert (len(lost.points), lost.texts[0].text) == (0, "searching, not valid: too dark")


def test_every_number_of_the_annotations_is_one(messages: dict[str, list[Any]]) -> None:
    points = [
        p for m in messages["/pipeline/debug/left/annotations"] for a in m.points for p in a.points
    ]
    assert np.isfinite([(p.x, p.y) for p in points]).all()


def test_images_are_those_of_the_camera(messages: dict[str, list[Any]], tmp_path: Path) -> None:
    images, infos = messages[LEFT_IMAGE], messages["/pipeline/debug/left/camera_info"]
    for index, (image, info) in enumerate(zip(images, infos, strict=True)):
        assert stamp_ns(image.header) == stamp_ns(info.header) == SEA.stamp(index)
        assert image.header.frame_id == info.header.frame_id == FRAME
        assert image.format == "jpeg"
        picture = cv2.imdecode(image.data, cv2.IMREAD_UNCHANGED)
        assert picture.shape == (HEIGHT, WIDTH), "no wider than the camera's"
        assert picture.mean() == pytest.approx(SEA.level(index), abs=3)
        assert camera_from_info(info) == LEFT
    small = replayed(tmp_path / "small", **{"result.image_width": 32})
    with BagReader(small) as bag:
        image = bag.first(LEFT_IMAGE)
        assert cv2.imdecode(image.data, cv2.IMREAD_UNCHANGED).shape == (24, 32)
        info = bag.first("/pipeline/debug/left/camera_info")
        assert info.width == WIDTH, "annotations are in its pixels"


def test_images_can_be_left_out(tmp_path: Path) -> None:
    without = replayed(tmp_path, **{"result.image_width": 0})
    with BagReader(without) as bag:
        assert LEFT_IMAGE not in bag.topics
        assert bag.topics["/pipeline/debug/left/annotations"].count == SEA.frames


def test_frames_lead_from_odom_to_the_camera(messages: dict[str, list[Any]]) -> None:
    (static,) = messages["/tf_static"]
    parent, child, mounting = transform_from_message(static.transforms[0])
    assert (parent, child) == ("base_link", FRAME)
    assert mounting.translation == pytest.approx(MOUNTING.translation)
    assert mounting.rotation == pytest.approx(MOUNTING.rotation, abs=1e-5)
    poses = [pose_from_message(m) for m in messages["/vnm/pose"]]
    for message, (stamp, pose) in zip(messages["/tf"], poses, strict=True):
        parent, child, moved = transform_from_message(message.transforms[0])
        assert (parent, child) == ("odom", "base_link")
        assert stamp_ns(message.transforms[0].header) == stamp
        assert moved.translation == pytest.approx(pose.translation)
        assert moved.rotation == pytest.approx(pose.rotation)
    shown = messages["/pipeline/markers"][0].markers[0], messages["/pipeline/centerline"][0]
    assert [message.header.frame_id for message in shown] == ["base_link", "odom"]


def test_late_comers_get_the_mounting_too(result: Path) -> None:
    metadata = yaml.safe_load((result / "metadata.yaml").read_text())
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    (static,) = (t for t in topics if t["topic_metadata"]["name"] == "/tf_static")
    (profile,) = static["topic_metadata"]["offered_qos_profiles"]
    assert (profile["durability"], profile["reliability"]) == ("transient_local", "reliable")


# Foxglove's layout.


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(config_path("foxglove_layout.json").read_text())


def panels_in(part: Any) -> Iterator[str]:
    if isinstance(part, str):
        yield part
    else:
        assert part["direction"] in ("row", "column")
        assert 0 < part["splitPercentage"] < 100
        yield from panels_in(part["first"])
        yield from panels_in(part["second"])


def test_every_panel_has_a_place_and_settings(layout: dict[str, Any]) -> None:
    placed = [*panels_in(layout["layout"])]
    for panel in tuple(placed):
        for tab in layout["configById"][panel].get("tabs", ()):
            placed += panels_in(tab["layout"])
    assert sorted(placed) == sorted(layout["configById"])
    kinds = {"3D", "Image", "Plot", "RawMessages", "StateTransitions", "Tab"}
    assert {panel.split("!")[0] for panel in placed} == kinds


def path_type(path: str) -> str:
    """Follow a message path; return the type of what it leads to."""
    topic, *fields = path.split(".")
    assert topic in KNOWN, path
    kind = KNOWN[topic]
    if fields and fields[-1].startswith("@"):
        assert fields.pop() == "@rad2deg"
    for field in fields:
        members = dict(our_typestore().fielddefs[kind][1])
        assert field in members, path
        node, description = members[field]
        kind = description if node == Nodetype.NAME else description[0]
    return kind


def test_plots_show_numbers_that_there_are(layout: dict[str, Any]) -> None:
    numbers = {"float64", "float32"}
    for name, panel in layout["configById"].items():
        for path in panel.get("paths", ()):
            kind = path_type(path["value"])
            allowed = numbers if name.startswith("Plot") else {"uint8", "string", "bool"}
            assert kind in allowed, path["value"]
            assert path["enabled"]
            assert path["timestampMethod"] == "receiveTime"
            has_header = "header" in dict(
                our_typestore().fielddefs[KNOWN[path["value"].split(".")[0]]][1]
            )
            assert has_header or path["value"].split(".")[1] == "data"
    assert path_type(layout["configById"]["RawMessages!state"]["topicPath"]) == (
        "pipeline_tracker_msgs/msg/RelativeState"
    )


def test_pictures_have_calibration_and_annotations(layout: dict[str, Any]) -> None:
    shown = layout["configById"]["Image!replay"]["imageMode"]
    assert KNOWN[shown["imageTopic"]] in IMAGES
    assert KNOWN[shown["calibrationTopic"]] == "sensor_msgs/msg/CameraInfo"
    assert {KNOWN[topic] for topic in shown["annotations"]} == {
        "foxglove_msgs/msg/ImageAnnotations"
    }
    assert all(value["visible"] for value in shown["annotations"].values())
    live = layout["configById"]["Image!live"]["imageMode"]
    assert live["imageTopic"] in LIVE


def test_3d_follows_the_vehicle_and_shows_the_pipe(layout: dict[str, Any]) -> None:
    panel = layout["configById"]["3D!pipe"]
    assert panel["followTf"] == "base_link"
    assert {KNOWN[topic] for topic in panel["topics"]} <= IN_3D
    assert {"/pipeline/markers", "/pipeline/centerline"} <= set(panel["topics"])


# RViz.


def test_rviz_shows_topics_that_there_are_with_fitting_qos() -> None:
    document = yaml.safe_load(config_path("pipeline.rviz").read_text())
    manager = document["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "odom"
    displays = {d["Name"]: d for d in manager["Displays"]}
    kinds = {
        "MarkerArray": "visualization_msgs/msg/MarkerArray",
        "Path": "nav_msgs/msg/Path",
        "Pose": "geometry_msgs/msg/PoseStamped",
        "Image": "sensor_msgs/msg/CompressedImage",
    }
    for display in displays.values():
        package, _, kind = display["Class"].partition("/")
        assert package == "rviz_default_plugins"
        if "Topic" in display:
            assert KNOWN[display["Topic"]["Value"]] == kinds[kind]
            assert display["Topic"]["Durability Policy"] == "Volatile"
            # RViz takes the transport from the end of an image's name.
            assert kind != "Image" or display["Topic"]["Value"].endswith("/compressed")
    # Poses come best effort; a reliable subscription would never get one.
    assert displays["Vehicle"]["Topic"]["Reliability Policy"] == "Best Effort"
