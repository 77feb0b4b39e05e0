"""`info` tells what is in a bag and what a replay would lack."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from bag_maker import START, Sea, mcap_of, write_bag

from pipeline_tracker.cli import run_command

IMAGE = "/stereo/left/image_rect"


def say(bag: Path, capsys: pytest.CaptureFixture[str], *options: str) -> Any:
    assert run_command(["info", str(bag), "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


def topic(info: Any, name: str) -> Any:
    (found,) = [t for t in info["topics"] if t["name"] == name]
    return found


def test_a_whole_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info = say(write_bag(tmp_path / "bag"), capsys, "--set", "pipe.diameter=0.6")
    image = topic(info, IMAGE)
    assert (image["count"], image["summary"], image["back"]) == (4, 4, 0)
    assert image["rate"] == pytest.approx(2.0)
    assert image["longest_gap"] == pytest.approx(0.5)
    assert info["seconds"] == pytest.approx(1.5)
    assert info["replay"]["topics.left_image"] == IMAGE
    assert info["replay"]["baseline"] == pytest.approx(0.2)
    assert info["replay"]["camera.translation"] == pytest.approx([0.3, 0.1, -0.1])
    assert info["missing"] == info["damage"] == []


def test_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info = say(write_bag(tmp_path / "a", Sea(static=False, pose="").items()), capsys)
    assert [line.split(":")[0] for line in info["missing"]][-1].startswith("pipe.diameter")
    assert any("mounting" in line for line in info["missing"])
    items = [i for i in Sea(pose="").items() if not (i.topic == IMAGE and i.log_ns == START)]
    info = say(write_bag(tmp_path / "b", items), capsys)
    assert any("vehicle poses" in line for line in info["missing"])
    assert any("3 of /stereo/left/image_rect, 4 of" in line for line in info["missing"])


def test_damage_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag", Sea(frames=6).items())
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace("message_count: 6", "message_count: 7"))
    info = say(bag, capsys)
    assert topic(info, IMAGE)["count"] == 6
    assert any("of the 7 messages" in line for line in info["damage"])
    file = mcap_of(bag)
    file.write_bytes(file.read_bytes()[:20000])
    info = say(bag, capsys)
    assert 0 < topic(info, IMAGE)["count"] < 6
    assert any("truncated" in line for line in info["damage"])


def test_for_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag")
    assert run_command(["info", str(bag), "--set", "pipe.diameter=0.6"]) == 0
    out = capsys.readouterr().out
    assert "4, at 2.00 Hz, longest gap 0.50 s" in out
    assert "nothing is missing for a replay" in out
    assert run_command(["info", str(tmp_path / "none")]) == 2
    assert run_command(["info", str(bag), "--set", "pipe.diametre=0.6"]) == 2
    junk = tmp_path / "a.mcap"
    junk.write_bytes(b"no bag" * 100)
    assert run_command(["info", str(junk)]) == 2
