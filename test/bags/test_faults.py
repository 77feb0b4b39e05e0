"""What can be wrong with a bag: each fault has its line, or its treatment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_maker import FACTORY, START, Item, Sea, write_bag
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.replay.bag_info import bag_info
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.replay.summary import ReplaySummary
from pipeline_tracker.settings_io import settings_from_values

LEFT, RIGHT = "/stereo/left/image_rect", "/stereo/right/image_rect"
POSE, INFO = "/vnm/pose", "/stereo/left/camera_info"
SETTINGS = settings_from_values({"pipe.diameter": 0.6})
BARE: dict[str, Any] = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}


def write_mcap(
    path: Path,
    items: list[Item],
    channel: Callable[[Item], Any] = lambda item: item.type_name,
    **options: Any,
) -> Path:
    """Write a file; messages for which ``channel`` gives another value have another channel."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=4096, **options)
        writer.start(profile="ros2", library="test")
        schemas: dict[str, int] = {}
        channels: dict[Any, int] = {}
        for item in items:
            if item.type_name not in schemas:
                text, _ = FACTORY.store.generate_msgdef(item.type_name, ros_version=2)
                schemas[item.type_name] = writer.register_schema(
                    item.type_name, "ros2msg", text.encode()
                )
            key = item.topic, channel(item)
            if key not in channels:
                schema = schemas[item.type_name]
                channels[key] = writer.register_channel(item.topic, "cdr", schema)
            data = FACTORY.serialize(item.message)
            writer.add_message(channels[key], item.log_ns, data, item.log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def of_another_type(topic: str, since: int = 0) -> list[Item]:
    def change(item: Item) -> Item:
        if item.topic != topic or item.log_ns < since:
            return item
        return replace(item, type_name="std_msgs/msg/Header", message=item.message.header)

    return [change(item) for item in Sea().items()]


def refused(bag: Path, capsys: pytest.CaptureFixture[str], *options: str) -> str:
    """Replay and return the one line that refuses it."""
    output = bag.with_name("out")
    arguments = ["replay", str(bag), "--output", str(output), "--set", "pipe.diameter=0.6"]
    assert run_command([*arguments, *options]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert not said.out
    assert not output.exists(), "nothing is written"
    return said.err


def frames(bag: Path) -> int:
    with BagReader(bag) as reader:
        source = ReplayInput(reader, SETTINGS)
        found: Iterator[Any] = source.frames(PoseBuffer(3.0), lambda: None)
        return sum(frame.left is not None for frame in found)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize(
    "options",
    [
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.NONE, "use_chunking": False},
        {"index_types": IndexType.NONE, "use_statistics": False},
        BARE,
        {**BARE, "use_chunking": False},
    ],
    ids=["no index", "no chunks", "no statistics", "no summary", "nothing but messages"],
)
def test_without_index_or_summary_all_is_read(
    tmp_path: Path, compression: CompressionType, options: dict[str, Any]
) -> None:
    bag = write_mcap(tmp_path / "a.mcap", list(Sea().items()), compression=compression, **options)
    assert frames(bag) == 4
    info = bag_info(bag, SETTINGS, has_diameter=True)
    assert not info.damage
    assert sum(topic.count for topic in info.topics) == 21


def test_without_index_and_out_of_order_names_salvage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    items = sorted(Sea().items(), key=lambda item: -item.log_ns)
    bag = write_mcap(tmp_path / "a.mcap", items, use_chunking=False, **BARE)
    info = bag_info(bag, SETTINGS, has_diameter=True)
    assert "not in timestamp order" in info.damage[0]
    assert "salvage" in info.damage[0]
    # The salvaged bag has an index.
    assert run_command(["salvage", str(bag), "--output", str(tmp_path / "saved")]) == 0
    assert "21 messages saved" in capsys.readouterr().out
    assert frames(tmp_path / "saved") == 4


def test_two_channels_of_one_name_and_type_are_one_topic(tmp_path: Path) -> None:
    """As two publishers of different QoS are recorded."""
    items = list(Sea(frames=8).items())
    bag = write_mcap(tmp_path / "a.mcap", items, channel=lambda item: item.log_ns // 10**9 % 2)
    with BagReader(bag) as reader:
        assert reader.topics[LEFT].count == 8
    assert frames(bag) == 8


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        (LEFT, f"images of one camera only ({RIGHT}), expected a left and a right one, {LEFT} has"),
        (RIGHT, f"images of one camera only ({LEFT}), expected a left and a right one, {RIGHT} ha"),
        (INFO, "expected sensor_msgs/msg/CameraInfo; record it so, or name another topic with "),
        (POSE, "expected geometry_msgs/msg/PoseStamped or geometry_msgs/msg/PoseWithCovariance"),
    ],
)
@pytest.mark.parametrize("since", [0, START + 1], ids=["wrong type", "two types"])
def test_a_topic_of_another_type(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    topic: str,
    expected: str,
    since: int,
) -> None:
    bag = write_mcap(tmp_path / "a.mcap", of_another_type(topic, since))
    line = refused(bag, capsys)
    assert expected in line
    kind = "messages of several types" if since else "the type std_msgs/msg/Header"
    assert f"{topic} has {kind}" in line


def test_a_pose_of_another_type_than_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag")
    line = refused(bag, capsys, "--set", "pose_type=odometry")
    assert f"{POSE} has the type geometry_msgs/msg/PoseStamped, expected nav_msgs/msg/Od" in line


def test_no_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    items = [item for item in Sea().items() if "image" not in item.topic]
    line = refused(write_bag(tmp_path / "bag", items), capsys)
    assert "no images in the bag, expected sensor_msgs/Image or CompressedImage; it has " in line
    # A topic that was recorded, and on which nobody spoke.
    topics = dict.fromkeys((LEFT, RIGHT), "sensor_msgs/msg/Image")
    silent = write_bag(tmp_path / "silent", items, silent=topics)
    line = refused(silent, capsys)
    assert f"no images in the bag, expected some; {LEFT}, {RIGHT} without messages" in line


@pytest.mark.parametrize("topic", [LEFT, RIGHT, INFO, POSE, "/tf_static"])
def test_what_cannot_be_read_is_counted(tmp_path: Path, topic: str) -> None:
    def cut(item: Item) -> Item:
        data = FACTORY.serialize(item.message)[:30]
        return replace(item, message=data) if item.topic == topic else item

    # The first of each is sound, so that the replay can begin.
    items = [*Sea(frames=1).items(), *map(cut, list(Sea(frames=3).items()))]
    bag = write_bag(tmp_path / "bag", items)
    with BagReader(bag) as reader:
        source = ReplayInput(reader, SETTINGS)
        for _ in source.frames(PoseBuffer(3.0), lambda: None):
            pass
        counts = source.counts
    expected = 1 if topic == "/tf_static" else 3
    if topic == POSE:
        assert counts.unused_poses["invalid"] == expected
        assert "cannot be read" in counts.first_invalid_pose
    else:
        assert counts.unreadable == {topic: expected}
    text = ReplaySummary().in_words(bag, tmp_path, SETTINGS, counts, [], has_truth=False)
    told = f"{expected} invalid" if topic == POSE else f"of {topic} could not be read"
    assert told in text


@pytest.mark.parametrize("field", [b"is_bigendian", b"frame_id"])
def test_a_definition_without_a_field_that_is_needed(tmp_path: Path, field: bytes) -> None:
    (bag,) = write_bag(tmp_path / "bag").glob("*.mcap")
    other = tmp_path / "other.mcap"
    other.write_bytes(bag.read_bytes().replace(field, field[::-1]))
    with BagReader(other) as reader:
        topics = [t.name for t in reader.topics.values() if t.type_name == "sensor_msgs/msg/Image"]
        images = list(reader.records(topics))
        assert images
        with pytest.raises(BagError, match=f"definition of its type has no .*{field.decode()}"):
            images[0].unpack()
