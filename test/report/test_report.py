"""report.html: what it says of each kind of replay, and that it needs nothing else."""

from __future__ import annotations

import json
import math
import os
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
import stand_in
from bag_maker import Sea, write_bag

from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError
from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.report.write import write_report
from pipeline_tracker.types import State, TrackingStatus
from pipeline_tracker.vectorization.vectorizer import thumbnail

ROOT = Path(__file__).resolve().parents[2]
Make = Callable[..., Path]


class Page(HTMLParser):
    """A page taken apart: its data, its words, and its elements with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text
        self.words, self.raw, self.elements = "", {}, []
        self._inside: list[tuple[str, str]] = []
        self.feed(text)

    @classmethod
    def of(cls, directory: Path) -> Page:
        return cls((directory / "report.html").read_text(encoding="utf-8"))

    @property
    def data(self) -> dict[str, Any]:
        return json.loads(self.raw["data"], parse_constant=pytest.fail)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.elements.append((tag, given))
        if tag not in ("meta", "img", "input"):
            self._inside.append((tag, given.get("id", "")))

    def handle_endtag(self, tag: str) -> None:
        assert self._inside.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        tag, name = self._inside[-1] if self._inside else ("", "")
        if tag in ("script", "style"):
            self.raw[name] = data
        else:
            self.words += data.replace("\N{NO-BREAK SPACE}", " ") + "\n"


def lost_between(first: int, last: int) -> Callable[[int], int]:
    return lambda i: 50 if first <= i <= last else 150 + i


def test_the_page_needs_nothing_else(make: Make) -> None:
    page = Page.of(make(Sea(frames=8)))
    for tag, attributes in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base", "a")
        assert not (tag == "script" and "src" in attributes)
        assert attributes.get("src", "data:").startswith("data:")
        assert not any(name.startswith("on") for name in attributes)
    assert not re.search(r"url\(|@import", page.raw[""])
    policy = next(a for _, a in page.elements if "http-equiv" in a)["content"]
    assert "default-src 'none'" in policy
    assert len(page.data["pictures"]) == 8
    assert len({a["src"] for tag, a in page.elements if tag == "img" and "src" in a}) == 8


def test_a_loss_is_told_with_place_and_reason(make: Make) -> None:
    page = Page.of(make(Sea(frames=12, level=lost_between(4, 6))))
    assert "The pipe was followed in 9 of 12 frames (75 %)" in page.words
    told = "It was lost once: at 2.0 s, chainage 0.6 m, for 3 frames, 0.8 m (too dark)."
    assert told in page.words
    data = page.data
    assert data["lost"] == [[4, 6, 0]]
    columns = data["columns"]
    assert columns["valid"] == [1] * 4 + [0] * 3 + [1] * 5
    assert columns["quality"][4] == 0.0
    assert columns["quality"][0] == pytest.approx(150 / 255, abs=0.01)
    assert columns["distance"][4] is None
    # The stand-in's segment is 1.25 m before the vehicle and 0.15 m to port; the vehicle makes
    # 0.2 m a frame along x, its bow 0.1 rad to port.
    x = 1.25 * math.cos(0.1) - 0.15 * math.sin(0.1)
    assert columns["pipeX"][:3] == pytest.approx([x, x + 0.2, x + 0.4], abs=2e-3)
    assert columns["pipeChainage"][:3] == pytest.approx([1.25, 1.45, 1.65], abs=2e-3)
    assert columns["ownX"][4] == pytest.approx(0.8)
    assert columns["sigmaLeft"][0] == pytest.approx(0.01)


def test_a_pipe_found_late_and_lost_often(make: Make) -> None:
    page = Page.of(make(Sea(frames=30, level=lambda i: 50 if i < 3 or i % 4 == 3 else 150)))
    assert "It was found in frame 5 (2.0 s), not before (too dark)." in page.words
    assert "It was lost 6 times, for 6 frames in all; the 4 longest: " in page.words


def test_never_found(make: Make) -> None:
    output = make(Sea(level=lambda _: 50))
    page = Page.of(output)
    assert "The pipe was not found in any of 4 frames." in page.words
    assert "Why: too dark (4 frames)." in page.words
    assert "pipe.diameter (0.6 m)" in page.words
    assert len(page.data["pictures"]) == 4
    assert set(page.data["columns"]["heading"]) == {None}


@pytest.mark.parametrize(
    ("sea", "options", "said"),
    [
        (Sea(pose=""), {}, "There are no poses of the vehicle: each frame stands alone"),
        (Sea(), {"mode": "mono"}, "One camera was used"),
        (Sea(), {"recognition__only": True}, "Each frame was recognised by itself, as asked"),
        (Sea(frames=1), {}, "The pipe was followed in 1 of 1 frame (100 %)."),
        (Sea(frames=1, level=lambda _: 50), {}, "The pipe was not found in the only frame."),
    ],
)
def test_each_kind_of_replay(make: Make, sea: Sea, options: dict[str, Any], said: str) -> None:
    page = Page.of(make(sea, **options))
    assert said in page.words
    assert "None" not in page.words
    assert "nan" not in page.words.lower().split()
    assert len(page.data["columns"]["t"]) == sea.frames
    has_plan = any(attributes.get("id") == "plan" for _, attributes in page.elements)
    assert has_plan == bool(sea.pose)


def test_images_that_cannot_be_read_are_rows_without_a_picture(make: Make, tmp_path: Path) -> None:
    items = list(Sea(frames=6).items())
    broken = [
        replace(item, message=replace(item.message, height=7))
        if item.topic == "/stereo/left/image_rect" and item.log_ns == Sea().stamp(2)
        else item
        for item in items
    ]
    bag = write_bag(tmp_path / "broken", broken)
    page = Page.of(make(bag))
    assert page.data["columns"]["state"][2] == 0
    assert page.data["pictures"] == [0, 1, 3, 4, 5]
    assert "not processed" in page.words


def test_where_no_frame_was_processed_the_rows_tell_why(make: Make, tmp_path: Path) -> None:
    items = list(Sea().items())
    for item in items:
        if item.topic.endswith("image_rect"):
            item.message.encoding = "32FC1"
    page = Page.of(make(write_bag(tmp_path / "depths", items)))
    assert "The pipe was not found in any of 4 frames." in page.words
    assert "32FC1" in page.words
    assert set(page.data["columns"]["state"]) == {0}


def test_an_interrupted_replay_says_so(make: Make) -> None:
    def stop(index: int) -> None:
        if index == 2:
            os.kill(os.getpid(), signal.SIGINT)

    page = Page.of(make(Sea(frames=9), before=stop))
    assert "The replay was interrupted after 3 of 9 frames." in page.words


def test_a_replay_that_was_cut_off_says_so(make: Make) -> None:
    output = make(Sea(frames=5))
    (output / "run.json").unlink()
    table = output / "estimates.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(lines[:4]) + lines[4][:30])
    write_report(output)
    page = Page.of(output)
    assert "The replay was cut off before its end" in page.words
    assert "The pipe was followed in 3 of 3 frames" in page.words


def test_a_damaged_bag_has_a_report_on_what_was_read(make: Make, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "cut", Sea(frames=6).items())
    output = tmp_path / "output0"
    metadata = bag / "metadata.yaml"
    # The bag says that it has more images than it has.
    metadata.write_text(metadata.read_text().replace("message_count: 6", "message_count: 8"))
    with pytest.raises(BagError, match="damaged"):
        make(bag)
    page = Page.of(output)
    assert "The replay ended early: " in page.words
    assert "6 of 6 frames" in page.words


def test_hostile_names_stay_text(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    evil = '"><script>alert(1)<!--&amp;'
    real = stand_in.TrackingStatus

    def status(stamp_ns: int, state: State, _reason: str, *rest: Any) -> TrackingStatus:
        return real(stamp_ns, state, f"</script>{evil}", *rest)

    monkeypatch.setattr(stand_in, "TrackingStatus", status)
    output = make(Sea(level=lost_between(1, 1)), name=evil, frames__odom=evil)
    page = Page.of(output)
    assert "</script>" not in page.raw["data"]
    assert [tag for tag, _ in page.elements].count("script") == 3
    assert page.text.count("<script") == 3
    assert evil in page.words
    assert any(evil in reason for reason in page.data["reasons"])


def test_names_that_are_no_text_are_shown_as_far_as_they_are(make: Make) -> None:
    page = Page.of(make(Sea(), name=os.fsdecode(b"s\xffa")))
    assert "s?a" in page.words


# The command.


def test_the_command_writes_it_again(make: Make, capsys: pytest.CaptureFixture[str]) -> None:
    output = make(Sea(frames=6, level=lost_between(2, 3)))
    before = (output / "report.html").read_bytes()
    (output / "report.html").unlink()
    assert run_command(["report", str(output)]) == 0
    assert capsys.readouterr().out == f"written to {output / 'report.html'}\n"
    assert (output / "report.html").read_bytes() == before


def test_the_truth_is_shown_where_it_is_known(
    make: Make, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The stand-in finds a pipe in the dark sea too, at a wrong place, and its thumbnails are such
    # as the truth's images have.
    process = stand_in.StandIn.process

    def seen(self: stand_in.StandIn, stamp_ns: int, rig: StereoRig, left: Any, *rest: Any) -> Any:
        found = process(self, stamp_ns, rig, left, *rest)
        return replace(found, vectorized=replace(found.vectorized, left_thumbnail=thumbnail(left)))

    monkeypatch.setattr(stand_in.StandIn, "process", seen)
    monkeypatch.setattr(stand_in, "BRIGHT", 0.0)
    measured = []
    monkeypatch.setattr(
        "pipeline_tracker.evaluation.evaluate",
        lambda *given: measured.append(evaluate(*given)) or measured[0],
    )
    demo = ROOT / "bags" / "demo"
    output = make(demo)
    assert "Errors against the truth" not in Page.of(output).words
    assert run_command(["report", str(output), "--truth", str(demo)]) == 0
    asked = Page.of(output)
    assert "Errors against the truth" in asked.words
    assert "20 valid frames had it wrong" in asked.words
    assert len(asked.data["errors"]["horizontal"]) == 20
    assert asked.data["errors"]["wrong"] == list(range(20))
    (output / "evaluation.json").write_text(measured[0].model_dump_json())
    assert run_command(["report", str(output)]) == 0
    assert Page.of(output).data["errors"] == asked.data["errors"]

    other = make(Sea())
    (other / "evaluation.json").write_bytes((output / "evaluation.json").read_bytes())
    capsys.readouterr()
    assert run_command(["report", str(other)]) == 2
    assert "it is of another replay" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("estimates.csv", "stamp_ns,state\n", "it has no column valid"),
        ("estimates.csv", None, "no estimates.csv in it"),
        ("settings.yaml", None, "no settings.yaml in it"),
        ("settings.yaml", "pipe.diameter: wide\n", "pipe.diameter"),
        ("run.json", "{}", "damaged or of another version (version: Field required); replay again"),
        ("evaluation.json", "[", "damaged or of another version"),
        ("result/result.mcap", "short", "result"),
    ],
)
def test_what_is_damaged_is_refused(
    make: Make, capsys: pytest.CaptureFixture[str], name: str, content: str | None, said: str
) -> None:
    output = make()
    if content is None:
        (output / name).unlink()
    else:
        (output / name).write_text(content)
    assert run_command(["report", str(output)]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1


def test_a_damaged_number_is_refused(make: Make, capsys: pytest.CaptureFixture[str]) -> None:
    output = make()
    table = output / "estimates.csv"
    table.write_text(table.read_text().replace("0.200000000", "far"))
    assert run_command(["report", str(output)]) == 2
    assert "could not convert string to float: 'far'" in capsys.readouterr().err


def test_somebody_elses_pictures_are_not_deleted(make: Make, tmp_path: Path) -> None:
    from pipeline_tracker.replay import replay
    from pipeline_tracker.settings_io import settings_from_values

    output = make(Sea(frames=6), name="first")
    kept = output / "frames" / "holiday.jpg"
    kept.write_bytes(b"mine")
    bag = write_bag(tmp_path / "shorter", Sea(frames=2).items())
    settings = settings_from_values({"pipe.diameter": 0.6})
    replay(bag, settings, output, force=True, make_pipeline=stand_in.StandIn)
    assert kept.read_bytes() == b"mine"
    assert len(list((output / "frames").iterdir())) == 3


def test_the_script_that_measures_long_reports_makes_them(make: Make, tmp_path: Path) -> None:
    spec = spec_from_file_location("long_report", ROOT / "test" / "soak" / "long_report.py")
    assert spec is not None
    assert spec.loader is not None
    script = module_from_spec(spec)
    spec.loader.exec_module(script)
    script.make(make(Sea(frames=5)), tmp_path / "long", 610)
    write_report(tmp_path / "long")
    page = Page.of(tmp_path / "long")
    assert "The pipe was followed in 603 of 610 frames (99 %)" in page.words
    assert page.data["lost"] == [[600, 606, 0]]
    assert 333 in page.data["pictures"]
