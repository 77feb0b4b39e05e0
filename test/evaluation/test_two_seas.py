"""Seas of one scenario with other seeds: the same stamps, another bed, path and noise."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pipeline_tracker.cli import run_command
from pipeline_tracker.replay import replay
from pipeline_tracker.settings_io import load_settings

pytest.importorskip("embreex", reason="the extra [sim] is not installed")

SMALL = ["frames=4", "camera.width=180", "camera.height=120"]


@pytest.fixture(scope="module")
def seas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two bags, one and two, and a replay of the first."""
    from pipeline_tracker.simulation import simulate

    place = tmp_path_factory.mktemp("seas")
    for seed, name in ((1, "one"), (2, "two")):
        simulate("demo", place / name, SMALL, seed)
    with Path(os.devnull).open("w") as nowhere:
        settings = load_settings(None, ["pipe.diameter=0.6"])
        replay(place / "one", settings, place / "replay", stream=nowhere)
    return place


def without(bag: Path, target: Path, topics: tuple[str, ...]) -> Path:
    """A copy of a bag without topics whose names begin so."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with (
        Reader(bag) as reader,
        Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        kept = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=store)
            for c in reader.connections
            if not c.topic.startswith(topics)
        }
        for connection, stamp, raw in reader.messages():
            if connection.id in kept:
                writer.write(kept[connection.id], stamp, raw)
    return target


@pytest.mark.parametrize(
    ("left_out", "reason"),
    [
        ((), "left image of stamp"),
        (("/stereo",), "poses of /vnm/pose are other ones"),
        (("/stereo", "/vnm"), "true motion is not the one"),
    ],
)
def test_the_truth_of_another_seed_is_refused(
    seas: Path,
    tmp_path: Path,
    left_out: tuple[str, ...],
    reason: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    directory = tmp_path / "replay"
    shutil.copytree(seas / "replay", directory)
    bags = {name: seas / name for name in ("one", "two")}
    if left_out:
        bags = {name: without(bag, tmp_path / name, left_out) for name, bag in bags.items()}
    assert run_command(["evaluate", str(directory), "--truth", str(bags["two"]), "--no-plots"]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
    assert not (directory / "evaluation.json").exists()
    assert run_command(["evaluate", str(directory), "--truth", str(bags["one"]), "--no-plots"]) == 0
    assert "of 4 frames valid" in capsys.readouterr().out
