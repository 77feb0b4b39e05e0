"""The commands: exit codes, and one line on stderr for whatever is wrong."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_maker import Item, Sea, mcap_of, write_bag
from stand_in import StandIn

from pipeline_tracker import __version__
from pipeline_tracker.cli import run_command

ROOT = Path(__file__).resolve().parents[2]
DIAMETER = ["--set", "pipe.diameter=0.6"]


pytestmark = pytest.mark.usefixtures("elsewhere")


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must fail with exit code 2 and one line; return the line."""

    def run(*arguments: str | Path) -> str:
        assert run_command([str(a) for a in arguments]) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith("pipeline-tracker: ")
        assert captured.err.endswith("\n")
        assert captured.err.count("\n") == 1
        assert "Traceback" not in captured.err + captured.out
        return captured.err.removeprefix("pipeline-tracker: ").rstrip("\n")

    return run


Refused = Callable[..., str]


def spoiled(topic: str, change: Callable[[Item], None], sea: Sea | None = None) -> list[Item]:
    items = list((sea or Sea()).items())
    for item in items:
        if item.topic == topic:
            change(item)
    return items


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["--version"]) == 0
    assert capsys.readouterr().out == f"pipeline-tracker {__version__}\n"


@pytest.mark.parametrize("command", ["", "replay", "run", "play", "simulate", "evaluate"])
def test_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command([*command.split(), "--help"]) == 0
    assert "Usage: pipeline-tracker" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ([], "no command given; see `pipeline-tracker --help`"),
        (["fly"], "no such command 'fly'; see `pipeline-tracker --help`"),
        (["replay"], "missing argument 'BAG'; see `pipeline-tracker replay --help`"),
        (["replay", "a", "b"], "b"),
        (["replay", "a", "--fast"], "--fast"),
        (["replay", "a", "--technique", "7"], "--technique 7: expected 1, 2, 3 or 4"),
        (["replay", "a", "--output"], "--output"),
        (["run", "fast"], "fast is not understood; ROS's own arguments follow --ros-args"),
        (["play"], "missing argument 'BAG'"),
        (["play", "a", "--rate", "fast"], "--rate fast: expected a number"),
        (["simulate"], "no SCENARIO given; `pipeline-tracker simulate --list` lists them"),
        (["simulate", "demo"], "no --output given"),
        (["simulate", "demo", "--output", "a", "--seed", "x"], "--seed x: expected an integer"),
        (["evaluate", "a"], "--truth"),
        (["evaluate"], "DIR"),
    ],
)
def test_wrong_commands(refused: Refused, arguments: list[str], line: str) -> None:
    assert line in refused(*arguments)


def test_replay_writes_where_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag(tmp_path / "dive")
    assert run_command(["replay", "dive", *DIAMETER]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "dive: 4 frames, pipe found in 4 (100 %)" in captured.out
    assert "Written to dive_tracked: " in captured.out
    files = {path.name for path in (tmp_path / "dive_tracked").iterdir()}
    assert {"estimates.csv", "result", "settings.yaml"} <= files


def test_replay_without_a_pipe_is_exit_code_1(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "dark", Sea(level=lambda _: 50).items())
    assert run_command(["replay", str(bag), *DIAMETER, "--output", "out"]) == 1
    assert len((tmp_path / "out" / "estimates.csv").read_text().splitlines()) == 5


def test_options_become_settings(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Sea(sides=("left",)).items())
    config = tmp_path / "my.yaml"
    config.write_text("pipe: {diameter: 0.5}\nsegment.length: 0.7\n")
    options = ["--mono", "--recognition-only", "--technique", "2", "--config", str(config)]
    assert run_command(["replay", str(bag), "--output", "out", *options]) == 0
    text = (tmp_path / "out" / "settings.yaml").read_text()
    for line in ("mode: mono", "only: true", "technique: 2", "diameter: 0.5", "length: 0.7"):
        assert line in text
    again = ["replay", str(bag), "--output", "again", "--config", "out/settings.yaml"]
    assert run_command(again) == 0
    assert (tmp_path / "again" / "settings.yaml").read_text() == text


def test_interrupted_replay_is_exit_code_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted(StandIn):
        def process(self, *arguments: object) -> object:
            if len(self.calls) == 2:
                os.kill(os.getpid(), signal.SIGINT)
            return super().process(*arguments)

    monkeypatch.setattr("pipeline_tracker.replay.runner.Pipeline", Interrupted)
    bag = write_bag(tmp_path / "bag", Sea(frames=8).items())
    assert run_command(["replay", str(bag), *DIAMETER, "--output", "out"]) == 130
    captured = capsys.readouterr()
    expected = "interrupted; what was computed is in out, --resume goes on with it"
    assert captured.err == f"pipeline-tracker: {expected}\n"
    assert "interrupted after 3 frames" in captured.out
    assert len((tmp_path / "out" / "estimates.csv").read_text().splitlines()) == 4


# Bad input, one line each.


def test_missing_bag(refused: Refused) -> None:
    assert refused("replay", "none", *DIAMETER).startswith("none: no such file or directory")


def test_empty_and_unreadable_bags(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").touch()
    assert "a.mcap: the file is empty" in refused("replay", "a.mcap", *DIAMETER)
    (tmp_path / "b.mcap").write_bytes(b"nonsense" * 100)
    assert "b.mcap: not a bag" in refused("replay", "b.mcap", *DIAMETER)
    (tmp_path / "c").mkdir()
    assert "c: no bag in this directory" in refused("replay", "c", *DIAMETER)
    write_bag(tmp_path / "d", [])
    assert "d: the bag is empty, it has no messages" in refused("replay", "d", *DIAMETER)


def test_no_images(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", [i for i in Sea().items() if i.topic == "/vnm/pose"])
    assert "bag: no images in the bag" in refused("replay", "bag", *DIAMETER)


def test_one_camera(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", Sea(sides=("left",)).items())
    line = refused("replay", "bag", *DIAMETER)
    assert "bag: images of one camera only (/stereo/left/image_rect)" in line
    assert "--mono" in line


def test_zero_calibration(refused: Refused, tmp_path: Path) -> None:
    def zero(item: Item) -> None:
        item.message.p = np.zeros(12)

    write_bag(tmp_path / "bag", spoiled("/stereo/right/camera_info", zero))
    line = refused("replay", "bag", *DIAMETER)
    assert "/stereo/right/camera_info: P has focal lengths fx=0, fy=0" in line


def test_no_diameter(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    line = refused("replay", "bag")
    assert "pipe.diameter is missing" in line
    assert "--set pipe.diameter=0.6" in line


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("pipe.diameter=-1", "--set pipe.diameter=-1: expected a number, above 0"),
        ("pipe.diameter=.nan", "--set pipe.diameter=nan: expected a number, above 0"),
        ("pipe.diametre=1", "unknown setting; did you mean pipe.diameter?"),
        ("pipe.diameter", "expected key=value"),
        ("motion.window=0", "--set motion.window=0: expected a number, above 0, at most 60 (s)"),
    ],
)
def test_bad_settings(refused: Refused, tmp_path: Path, setting: str, line: str) -> None:
    write_bag(tmp_path / "bag")
    assert line in refused("replay", "bag", *DIAMETER, "--set", setting)
    assert not (tmp_path / "bag_tracked").exists()


def test_missing_settings_file(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    line = refused("replay", "bag", "--config", "my.yaml")
    assert line.startswith("my.yaml: no such settings file")


def test_truncated_bag(refused: Refused, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    file = mcap_of(bag)
    file.write_bytes(file.read_bytes()[:-2000])
    line = refused("replay", "bag", *DIAMETER)
    assert line.startswith("bag: the bag is truncated")
    assert "`pipeline-tracker salvage bag --output DIR`" in line
    assert not (tmp_path / "bag_tracked").exists()


def test_output_that_is_not_empty(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").touch()
    line = refused("replay", "bag", *DIAMETER, "--output", "out")
    assert line.startswith("out: the output directory is not empty (it has mine)")
    assert "--force" in line
    assert run_command(["replay", "bag", *DIAMETER, "--output", "out", "--force"]) == 0


def test_no_mounting(refused: Refused, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", Sea(static=False).items())
    line = refused("replay", "bag", *DIAMETER)
    assert "the camera's mounting is not known" in line
    assert "--set camera.translation=[x,y,z]" in line
    line = refused("replay", "bag", *DIAMETER, "--set", "camera.translation=[0,0,0]")
    assert "camera.translation is given without camera.rotation_rpy" in line


def test_topics_that_are_not_clear(refused: Refused, tmp_path: Path) -> None:
    sea = Sea(sides=("0", "1"), image_topic="/cam{side}/image", info_topic="/cam{side}/camera_info")
    write_bag(tmp_path / "bag", sea.items())
    line = refused("replay", "bag", *DIAMETER)
    assert "/cam0/image, /cam1/image" in line
    assert "--set topics.left_image=/cam0/image" in line


def test_corrupt_image_is_one_frame_lost(tmp_path: Path) -> None:
    sea = Sea(encoding="jpeg")
    items = list(sea.items())
    for index, item in enumerate(items):
        if item.topic == "/stereo/left/image_rect/compressed" and item.log_ns == sea.stamp(2):
            item.message.data = item.message.data[:50]
            items[index] = replace(item)
    write_bag(tmp_path / "bag", items)
    assert run_command(["replay", "bag", *DIAMETER]) == 0
    with (tmp_path / "bag_tracked" / "estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["valid"] for row in rows] == ["1", "1", "0", "1"]
    assert rows[2]["reason"] == "left image: JPEG image is cut off after 50 bytes"


# Whole processes.

NO_ROS = """
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rclpy", "pipeline_tracker_msgs", "sensor_msgs", "std_msgs"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoRos())
from pipeline_tracker.cli import main
main()
"""


def process(*arguments: str, code: str | None = None) -> subprocess.CompletedProcess[str]:
    start = ["-m", "pipeline_tracker.cli"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *start, *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_replay_where_ros_cannot_be_imported(tmp_path: Path) -> None:
    """The real pipeline on pictures without a pipe, with rclpy and messages made un-importable."""
    write_bag(tmp_path / "bag", Sea(size=(320, 240)).items())
    done = process("replay", "bag", *DIAMETER, code=NO_ROS)
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    rows = (tmp_path / "bag_tracked" / "estimates.csv").read_text().splitlines()
    assert len(rows) == 5


@pytest.mark.parametrize("command", [["run", *DIAMETER], ["play", "bag"]])
def test_live_commands_say_what_they_need(tmp_path: Path, command: list[str]) -> None:
    write_bag(tmp_path / "bag")
    done = process(*command, code=NO_ROS)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"{command[0]} needs ROS 2" in done.stderr


def test_help_imports_little() -> None:
    code = (
        "import sys; from pipeline_tracker.cli import run_command; run_command(['--help']);"
        "print([m for m in ('numpy', 'cv2', 'numba', 'pydantic', 'rosbags') if m in sys.modules])"
    )
    assert process(code=code).stdout.splitlines()[-1] == "[]"


def test_output_into_a_closed_pipe_is_no_traceback() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "pipeline_tracker.cli", "replay", "--help"],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writer)
    assert done.stderr == ""
