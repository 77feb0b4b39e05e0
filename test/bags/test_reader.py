"""Bags of every kind are read, and damaged ones refused with one line that says what to do."""

from __future__ import annotations

import random
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from bag_maker import START, Sea, mcap_of, write_bag, write_small_chunks
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from pipeline_tracker.bags.reader import BagReader, BagRecord
from pipeline_tracker.errors import BagError
from pipeline_tracker.messages import stamp_ns

IMAGE = "/stereo/left/image_rect"
POSE = "/vnm/pose"


def stamps(path: Path, topic: str = IMAGE) -> list[int]:
    with BagReader(path) as bag:
        return [stamp_ns(record.unpack().header) for record in bag.records([topic])]


def refusal(path: Path, topic: str = IMAGE) -> str:
    with pytest.raises(BagError) as caught:
        stamps(path, topic)
    line = str(caught.value)
    assert "\n" not in line
    return line


EXPECTED = [Sea().stamp(i) for i in range(4)]


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", list(CompressionMode))
def test_every_storage_and_compression_of_rosbag2(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
) -> None:
    if storage == StoragePlugin.SQLITE3 and mode == CompressionMode.STORAGE:
        pytest.skip("a database has no compression of its own")
    bag = write_bag(tmp_path / "bag", storage=storage, compression=mode)
    assert stamps(bag) == EXPECTED


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"use_statistics": False}])
def test_a_single_mcap_of_every_compression(
    tmp_path: Path, compression: CompressionType, options: dict[str, Any]
) -> None:
    assert (
        stamps(write_small_chunks(tmp_path / "a.mcap", Sea(), compression, **options)) == EXPECTED
    )


def test_file_inside_a_bag_and_database_file(tmp_path: Path) -> None:
    assert stamps(mcap_of(write_bag(tmp_path / "a"))) == EXPECTED
    bag = write_bag(tmp_path / "b", storage=StoragePlugin.SQLITE3)
    (database,) = bag.glob("*.db3")
    assert stamps(database) == EXPECTED


def test_directory_without_metadata(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    assert stamps(bag) == EXPECTED


def split_bag(path: Path) -> Path:
    """Write a bag of two files, the first half and the second."""
    items = list(Sea().items())
    half = len(items) // 2
    first = write_bag(path, items[:half])
    second = write_bag(path.with_name("second"), items[half:])
    shutil.move(mcap_of(second), path / "part_1.mcap")
    mcap_of_first = next(f for f in first.glob("*.mcap") if f.name != "part_1.mcap")
    mcap_of_first.rename(path / "part_0.mcap")
    return path


def test_split_bag_without_metadata(tmp_path: Path) -> None:
    bag = split_bag(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    assert stamps(bag) == EXPECTED


def test_split_bag_with_metadata(tmp_path: Path) -> None:
    bag = split_bag(tmp_path / "bag")
    whole = write_bag(tmp_path / "whole")
    text = (whole / "metadata.yaml").read_text()
    # The list of files and each one's figures.
    text = text.replace("- whole.mcap", "- part_0.mcap\n  - part_1.mcap")
    (bag / "metadata.yaml").write_text(text.replace("path: whole.mcap", "path: part_0.mcap"))
    assert stamps(bag) == EXPECTED


def test_recorded_order_and_topics(tmp_path: Path) -> None:
    with BagReader(write_bag(tmp_path / "bag")) as bag:
        assert bag.topics[POSE].count == 4
        assert bag.topics[POSE].type_name == "geometry_msgs/msg/PoseStamped"
        records = list(bag.records([IMAGE, POSE]))
        assert [r.log_ns for r in records] == sorted(r.log_ns for r in records)
        assert bag.start_ns == START
        assert bag.end_ns > EXPECTED[-1]
        assert stamp_ns(bag.first(POSE).header) == START


def test_missing_path(tmp_path: Path) -> None:
    line = refusal(tmp_path / "none")
    assert line.startswith(f"{tmp_path / 'none'}: no such file or directory; expected a bag")


def test_file_of_another_kind(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    assert "not a bag, its name ends with '.txt'" in refusal(path)
    renamed = tmp_path / "notes.mcap"
    renamed.write_text("hello, this is no bag at all, and long enough to be taken for one")
    assert "not a bag" in refusal(renamed)
    renamed = tmp_path / "notes.db3"
    renamed.write_text("hello, this is no bag at all, and long enough to be taken for one")
    assert str(renamed) in refusal(renamed)


def test_empty_file_directory_and_bag(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    path.touch()
    assert refusal(path).startswith(f"{path}: the file is empty")
    (tmp_path / "dir").mkdir()
    assert "no bag in this directory" in refusal(tmp_path / "dir")
    (tmp_path / "dir" / "a.mcap").touch()
    assert "a.mcap: the file is empty" in refusal(tmp_path / "dir")
    assert "has no messages" in refusal(write_bag(tmp_path / "bag", []))


def test_missing_file_of_a_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    mcap_of(bag).unlink()
    line = refusal(bag)
    assert line.startswith(f"{bag}: ")
    assert "missing" in line


def test_bad_metadata(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    for text in ("", "[", "rosbag2_bagfile_information: 3", "a: b", "\x00"):
        (bag / "metadata.yaml").write_text(text)
        assert refusal(bag).startswith(f"{bag}: the bag is ")


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9, 0.999])
def test_truncated_file_names_salvage(tmp_path: Path, share: float) -> None:
    bag = write_bag(tmp_path / "bag")
    file = mcap_of(bag)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    for path in (bag, file):
        line = refusal(path)
        assert line.startswith(f"{path}: the bag is truncated")
        assert f"`pipeline-tracker salvage {path} --output DIR`" in line


def test_truncated_database_names_salvage(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    (database,) = bag.glob("*.db3")
    database.write_bytes(database.read_bytes()[:8192])
    assert "salvage" in refusal(bag)


def test_flipped_byte_in_a_chunk_names_salvage(tmp_path: Path) -> None:
    path = write_small_chunks(tmp_path / "a.mcap", Sea(), CompressionType.ZSTD)
    data = bytearray(path.read_bytes())
    zstd = b"\x28\xb5\x2f\xfd"
    data[data.index(zstd, len(data) // 3) + 40] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(BagError, match=r"damaged .*salvage"), BagReader(path) as bag:
        list(bag.records(bag.topics))


def test_short_read_is_not_silent(tmp_path: Path) -> None:
    """A message of the summary that the file does not hold."""
    bag = write_bag(tmp_path / "bag")
    text = (bag / "metadata.yaml").read_text()
    assert text.count("message_count: 4") > 1
    (bag / "metadata.yaml").write_text(text.replace("message_count: 4", "message_count: 5"))
    line = refusal(bag)
    assert f"damaged, 4 of the 5 messages of {IMAGE} can be read" in line
    assert "salvage" in line


def test_message_that_does_not_fit_its_type(tmp_path: Path) -> None:
    sea = Sea()
    items = list(sea.items())
    place = next(i for i, item in enumerate(items) if item.topic == IMAGE)
    items[place] = type(items[place])(
        IMAGE, items[place].type_name, START, b"\0\1\0\0" + b"\xff" * 9
    )
    with BagReader(write_bag(tmp_path / "bag", items)) as bag:
        first, *_ = bag.records([IMAGE])
        with pytest.raises(BagError, match=rf"a message of {IMAGE} \(sensor_msgs/msg/Image\)"):
            first.unpack()
        assert first.stamp_guess() == START, "the time of recording"
        # The first that can be read is the second.
        assert stamp_ns(bag.first(IMAGE).header) == EXPECTED[1]


@pytest.mark.parametrize("order", ["<", ">"])
def test_stamp_of_a_message_that_breaks_off(tmp_path: Path, order: str) -> None:
    stamp = START + 123
    raw = (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + struct.pack(
        f"{order}iI", *divmod(stamp, 1_000_000_000)
    )
    item = next(i for i in Sea().items() if i.topic == IMAGE)
    items = [type(item)(IMAGE, item.type_name, START, raw)]
    with BagReader(write_bag(tmp_path / "bag", items)) as bag:
        (record,) = bag.records([IMAGE])
        assert record.stamp_guess() == stamp


def test_bag_without_definitions_of_its_messages(tmp_path: Path) -> None:
    """Bags of old distributions hold none; ours are known."""
    bag = write_bag(tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    (database,) = bag.glob("*.db3")
    import sqlite3

    with sqlite3.connect(database) as connection:
        connection.execute("DELETE FROM message_definitions")
    connection.close()
    assert stamps(bag) == EXPECTED


def test_ros1_bag(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    path = tmp_path / "old.bag"
    with Writer(path) as writer:
        name = "geometry_msgs/msg/PoseStamped"
        connection = writer.add_connection(POSE, name, typestore=store)
        header = kinds["std_msgs/msg/Header"](
            seq=0, stamp=kinds["builtin_interfaces/msg/Time"](sec=5, nanosec=7), frame_id="odom"
        )
        pose = kinds["geometry_msgs/msg/Pose"](
            position=kinds["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
            orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        message = kinds[name](header=header, pose=pose)
        writer.write(connection, START, store.serialize_ros1(message, name))
    assert stamps(path, POSE) == [5_000_000_007]


def _unpack(record: BagRecord) -> None:
    try:
        record.unpack()
    except BagError as error:
        assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize("seed", range(60))
def test_mutated_bags_give_our_error_or_whole_messages(tmp_path: Path, seed: int) -> None:
    """Flips and cuts anywhere: all messages, or one line, and nothing in between in silence."""
    rng = random.Random(seed)  # noqa: S311 - a test's dice
    kinds = list(CompressionType)
    path = write_small_chunks(tmp_path / "a.mcap", Sea(), kinds[seed % len(kinds)])
    data = bytearray(path.read_bytes())
    for _ in range(rng.randint(1, 4)):
        place = rng.randrange(len(data))
        if rng.random() < 0.3:
            del data[place : place + rng.randint(1, 40)]
        else:
            data[place] = rng.randrange(256)
    path.write_bytes(data)
    try:
        with BagReader(path) as bag:
            for record in bag.records([t for t in (IMAGE, POSE) if t in bag.topics]):
                _unpack(record)
    except BagError as error:
        assert str(path) in str(error)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    ("encoding", "schema", "reason"),
    [("json", "ros2msg", "is encoded as 'json'"), ("cdr", "protobuf", "described by 'protobuf'")],
)
def test_other_encodings_are_refused(
    tmp_path: Path, encoding: str, schema: str, reason: str
) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2", library="test")
        identity = writer.register_schema("sensor_msgs/msg/Image", schema, b"uint8 a")
        channel = writer.register_channel(IMAGE, encoding, identity)
        writer.add_message(channel, START, b"{}", START)
        writer.finish()  # type: ignore[no-untyped-call]
    line = refusal(path)
    assert line.startswith(f"{path}: ")
    assert reason in line
    assert "expected" in line
