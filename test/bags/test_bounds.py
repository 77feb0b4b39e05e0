"""A hostile bag cannot make the reader take all memory."""

from __future__ import annotations

import bz2
from pathlib import Path
from types import SimpleNamespace

import lz4.frame
import pytest
import zstandard
from bag_maker import mcap_of, write_bag
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import CompressionMode, storage_mcap

from pipeline_tracker.bags import bounds
from pipeline_tracker.bags.chunks import LARGEST
from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import BagError


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_the_library_unpacks_within_the_size(name: str) -> None:
    pack = zstandard.compress if name == "zstd" else lz4.frame.compress
    assert len(storage_mcap.DECOMPRESSORS[name](pack(bytes(10_000_000)), 500)) == 500
    with pytest.raises(BagError, match="expected at most"):
        storage_mcap.DECOMPRESSORS[name](pack(b"a"), LARGEST + 1)


def chunk(start: int, end: int, size: int) -> SimpleNamespace:
    return SimpleNamespace(message_start_time=start, message_end_time=end, uncompressed_size=size)


def test_chunks_one_after_another_may_be_many() -> None:
    bounds._check([chunk(i, i, LARGEST) for i in range(100)])
    with pytest.raises(BagError, match="overlap in time"):
        bounds._check([chunk(0, 9, LARGEST) for _ in range(5)])
    with pytest.raises(BagError, match="a chunk of"):
        bounds._check([chunk(0, 9, LARGEST + 1)])


def test_bags_are_opened_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "bag", compression=CompressionMode.STORAGE)
    monkeypatch.setattr(bounds, "LARGEST", 1000)
    for path in (bag, mcap_of(bag)):
        with pytest.raises(BagError, match=f"{path}: .*expected at most 1000"), BagReader(path):
            pass


def test_a_bag_of_packed_files_is_unpacked_to_a_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "bag", compression=CompressionMode.FILE)
    with BagReader(bag) as reader:
        assert len(list(reader.records(reader.topics))) == 21
    (packed,) = bag.glob("*.zstd")
    bomb = zstandard.compress(bytes(30_000_000), 19)
    assert len(bomb) < 10_000
    packed.write_bytes(bomb)
    monkeypatch.setattr(bounds, "LARGEST", 1_000_000)
    line = f"{bag}: .*unpacks to more than 100 times its size.*"
    with pytest.raises(BagError, match=line), BagReader(bag):
        pass


def test_a_bag_of_packed_messages_is_unpacked_to_a_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_bag(tmp_path / "bag", compression=CompressionMode.MESSAGE)
    with BagReader(bag) as reader:
        assert len(list(reader.records(reader.topics))) == 21
    with BagReader(bag) as reader:
        monkeypatch.setattr(bounds, "LARGEST", 2000)
        with pytest.raises(BagError, match=f"{bag}: .*a message of 2000 bytes or more"):
            list(reader.records(reader.topics))


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_chunk_of_ros1_is_unpacked_to_a_bound(
    compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = bz2.compress if compression == "bz2" else lz4.frame.compress
    unpack = rosbag1_reader.decompressors[compression]
    assert unpack(pack(b"abc" * 1000)) == b"abc" * 1000
    monkeypatch.setattr(bounds, "LARGEST", 1_000_000)
    with pytest.raises(BagError, match="a chunk of more than 1000000 bytes"):
        unpack(pack(bytes(50_000_000)))
