"""A damaged bag gives back every message that is still whole, and counts the others."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from bag_maker import Sea, mcap_of, write_bag, write_small_chunks
from mcap.records import Chunk
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode

from pipeline_tracker.bags.chunks import LARGEST, unpack_chunk
from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.salvage import salvage
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError

IMAGE = "/stereo/left/image_rect"
Content = list[tuple[str, int, bytes]]


def content(path: Path) -> Content:
    with BagReader(path) as bag:
        return sorted((r.topic, r.log_ns, r.raw) for r in bag.records(bag.topics))


def saved(report: Any) -> int:
    return sum(topic.saved for topic in report.topics)


def lost(report: Any) -> int:
    return sum(topic.lost for topic in report.topics)


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.STORAGE])
def test_a_sound_bag_comes_back_whole(tmp_path: Path, mode: CompressionMode) -> None:
    bag = write_bag(tmp_path / "bag", compression=mode)
    report = salvage(bag, tmp_path / "out")
    assert content(tmp_path / "out") == content(bag)
    assert lost(report) == 0
    assert report.counted
    assert not report.notes


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_bag_gives_all_before_the_cut(
    tmp_path: Path, compression: CompressionType, options: dict[str, Any], share: float
) -> None:
    path = write_small_chunks(tmp_path / "a.mcap", Sea(frames=8), compression, **options)
    whole = content(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    report = salvage(path, tmp_path / "out")
    got = content(tmp_path / "out")
    in_order = sorted(whole, key=lambda message: message[1])
    first_missing = min(set(whole) - set(got), key=lambda message: message[1], default=None)
    assert set(got) <= set(whole)
    # Nothing is missing but the end: one message at most of a time with others.
    if first_missing is not None:
        before = [m for m in in_order if m[1] < first_missing[1]]
        assert set(before) <= set(got)
    assert len(got) >= (share - 0.3) * len(whole)
    assert saved(report) == len(got)


def test_counts_of_a_cut_bag_come_from_metadata(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Sea(frames=6).items())
    file = mcap_of(bag)
    total = len(content(bag))
    file.write_bytes(file.read_bytes()[:20000])
    report = salvage(bag, tmp_path / "out")
    assert report.counted
    assert 0 < saved(report) < total
    assert saved(report) + lost(report) == total
    (bag / "metadata.yaml").unlink()
    assert not salvage(bag, tmp_path / "again").counted


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_flipped_byte_costs_its_chunk_alone(tmp_path: Path, compression: CompressionType) -> None:
    path = write_small_chunks(tmp_path / "a.mcap", Sea(frames=8), compression)
    whole = content(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    report = salvage(path, tmp_path / "out")
    got = content(tmp_path / "out")
    assert set(got) < set(whole), "no message is kept changed"
    assert 0 < lost(report) == len(whole) - len(got) <= 6
    assert any("damaged" in note for note in report.notes)


@pytest.mark.parametrize("seed", range(12))
def test_a_wrong_length_costs_little(tmp_path: Path, seed: int) -> None:
    """The length of one chunk's record: what follows is found again."""
    kinds = list(CompressionType)
    path = write_small_chunks(tmp_path / "a.mcap", Sea(frames=8), kinds[seed % len(kinds)])
    whole = content(path)
    data = bytearray(path.read_bytes())
    place = data.index(b"\x06", 200 + 300 * seed)
    while not path_is_chunk(data, place):
        place = data.index(b"\x06", place + 1)
    data[place + 1 + seed % 8] ^= 1 << (seed % 7)
    path.write_bytes(data)
    salvage(path, tmp_path / "out")
    got = content(tmp_path / "out")
    assert set(got) <= set(whole)
    assert len(whole) - len(got) <= 6


def path_is_chunk(data: bytearray, place: int) -> bool:
    length = int.from_bytes(data[place + 1 : place + 9], "little")
    return 60 < length < 20000 and bytes(data[place + 37 : place + 41]) in (
        b"\0\0\0\0",
        b"\x03\0\0\0",
        b"\x04\0\0\0",
    )


def test_split_bag_and_missing_summary(tmp_path: Path) -> None:
    items = list(Sea().items())
    bag = write_bag(tmp_path / "bag", items[:12])
    second = write_bag(tmp_path / "second", items[12:])
    whole = sorted(content(bag) + content(second))
    shutil.move(mcap_of(second), bag / "z.mcap")
    (bag / "metadata.yaml").unlink()
    salvage(bag, tmp_path / "out")
    assert content(tmp_path / "out") == whole


def test_qos_is_kept(tmp_path: Path) -> None:
    demo = Path(__file__).resolve().parents[2] / "bags" / "demo"
    salvage(demo, tmp_path / "out")
    assert content(tmp_path / "out") == content(demo)
    with BagReader(demo) as old, BagReader(tmp_path / "out") as new:
        of = {c.topic: c.ext for c in old._readers[0].connections}
        assert of == {c.topic: c.ext for c in new._readers[0].connections}


def test_nothing_to_save(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    junk = tmp_path / "a.mcap"
    junk.write_bytes(bytes(range(256)) * 300)
    for path in (junk, tmp_path / "none.mcap", tmp_path):
        if path == tmp_path:
            junk.unlink()
        assert run_command(["salvage", str(path), "--output", str(tmp_path / "out")]) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        assert str(path) in line
        assert not (tmp_path / "out").exists()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")], "nothing is left behind"


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag")
    out = str(tmp_path / "out")
    assert run_command(["salvage", str(bag)]) == 2
    assert run_command(["salvage", str(bag), "--output", str(bag)]) == 2
    capsys.readouterr()
    assert run_command(["salvage", str(bag), "--output", out]) == 0
    assert f"{IMAGE}" in capsys.readouterr().out
    assert run_command(["salvage", str(bag), "--output", out]) == 2
    assert "not empty" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_bomb_is_not_unpacked(name: str) -> None:
    pack = zstandard.compress if name == "zstd" else lz4.frame.compress
    packed = pack(bytes(50_000_000))
    chunk = Chunk(name, packed, 0, 0, 0, 1000)
    assert len(unpack_chunk(chunk)) == 1000
    with pytest.raises(BagError, match="expected at most"):
        unpack_chunk(Chunk(name, packed, 0, 0, 0, LARGEST + 1))
