"""`play`: a bag on the live topics, with /clock."""

from __future__ import annotations

import re
import shlex
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_processes import is_ready
from rosbags.rosbag2 import StoragePlugin, Writer

from pipeline_tracker import messages
from pipeline_tracker.bags.typestore import BagMessages

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 5
SECOND = 1_000_000_000
IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
POSE, TRANSFORMS = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"


@pytest.fixture(scope="module")
def bag(scene: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small bag of the scene: images, infos, poses, and a topic that cannot be played."""
    path = tmp_path_factory.mktemp("play") / "bag"
    factory = BagMessages()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {"/vnm/pose": POSE, "/tf_static": TRANSFORMS}
        for side in ("left", "right"):
            kinds |= {f"/stereo/{side}/image_rect": IMAGE, f"/stereo/{side}/camera_info": INFO}
        connections = {
            topic: writer.add_connection(topic, kind, typestore=factory.store)
            for topic, kind in kinds.items()
        }

        def write(topic: str, stamp: int, message: Any) -> None:
            writer.write(connections[topic], stamp, factory.serialize(message))

        write("/tf_static", scene.stamp(0), factory.message(TRANSFORMS))
        for k in range(FRAMES):
            stamp = scene.stamp(k)
            header = messages.header_message(factory, stamp, "left_optical")
            pose = messages.pose_message(factory, scene.pose(k))
            write("/vnm/pose", stamp, factory.message(POSE, header=header, pose=pose))
            for side, camera, pixels in zip(
                ("left", "right"), scene.rig.cameras, scene.images(k), strict=True
            ):
                info = messages.camera_info_message(factory, camera, stamp, "left_optical")
                write(f"/stereo/{side}/camera_info", stamp, info)
                height, width = pixels.shape
                image = factory.message(
                    IMAGE,
                    header=header,
                    height=height,
                    width=width,
                    step=width,
                    encoding="mono8",
                    data=pixels.ravel(),
                )
                write(f"/stereo/{side}/image_rect", stamp, image)
    return path


def command(*arguments: str) -> str:
    return f"from pipeline_tracker.cli import main; main({list(arguments)!r})"


def listener(bench: Any) -> Any:
    """A node that takes all that the bag plays, and says so before it begins."""
    talker = bench.talker()
    for side in ("left", "right"):
        talker.hear(f"stereo/{side}/image_rect", IMAGE)
        talker.hear(f"stereo/{side}/camera_info", INFO)
    talker.hear("vnm/pose", POSE)
    talker.hear("/clock", "rosgraph_msgs/msg/Clock")
    return talker


def test_all_is_published_once_and_told(bench: Any, bag: Path) -> None:
    talker = listener(bench)
    process = bench.process(command("play", str(bag)))
    total = 5 * FRAMES
    got = talker.got
    talker.wait(lambda: sum(map(len, got.values())) - len(got["/clock"]) == total, "all messages")
    talker.wait(lambda: process.popen.poll() is not None, "the bag's end")
    assert process.popen.returncode == 0
    for k in range(FRAMES):
        for side, pixels in zip(("left", "right"), bench.scene.images(k), strict=True):
            message = got[f"stereo/{side}/image_rect"][k]
            assert messages.stamp_ns(message.header) == bench.scene.stamp(k)
            np.testing.assert_array_equal(np.frombuffer(message.data, np.uint8), pixels.ravel())
    clock = [m.clock.sec * SECOND + m.clock.nanosec for m in got["/clock"]]
    assert clock == sorted(clock)
    # From the first message to a moment after the last one.
    assert clock[0] == bench.scene.stamp(0)
    assert clock[-1] > bench.scene.stamp(FRAMES - 1)
    # 40 times a second, a few perhaps missed by a busy machine.
    assert len(clock) > 20
    assert process.err.read_text() == (
        "warning: left out, the Python package of the type is not installed: "
        "/tf_static (tf2_msgs/msg/TFMessage)\n"
    )
    lines = process.out.read_text().splitlines()
    assert lines[0] == f"played {bag}: {total} messages"
    assert lines[1].split() == ["5", "/stereo/left/camera_info"]
    assert len(lines) == 6


def test_the_pace_is_that_of_the_bag_times_the_rate(bench: Any, bag: Path) -> None:
    import time

    talker = listener(bench)
    arrivals: list[float] = []
    kept = talker.got["vnm/pose"]
    bench.process(command("play", str(bag), "--rate", "2"))

    def look() -> bool:
        while len(arrivals) < len(kept):
            arrivals.append(time.monotonic())
        return len(arrivals) == FRAMES

    talker.wait(look, "all poses")
    # Half a second apart in the bag; a busy machine may be late.
    assert 0.2 * (FRAMES - 1) < arrivals[-1] - arrivals[0] < 0.5 * (FRAMES - 1)


def test_without_listeners_it_warns_and_plays_all_the_same(bench: Any, bag: Path) -> None:
    code = "import pipeline_tracker.nodes.bag_player as player; player.MATCH_WITHIN = 0.3\n"
    process = bench.process(code + command("play", str(bag), "--rate", "50"))
    assert process.popen.wait(60.0) == 0
    left, right = "/stereo/left/image_rect", "/stereo/right/image_rect"
    assert f"nobody listens to {left}, {right}" in process.err.read_text()
    assert f"{5 * FRAMES} messages" in process.out.read_text()


def test_a_quiet_player_says_nothing(bench: Any, bag: Path) -> None:
    code = "import pipeline_tracker.nodes.bag_player as player; player.MATCH_WITHIN = 0.3\n"
    process = bench.process(code + command("play", str(bag), "--rate", "50", "-q"))
    assert process.popen.wait(60.0) == 0
    assert process.text == ""


def test_the_live_commands_of_the_docs_find_the_pipe(bench: Any) -> None:
    """As they stand in the first ten minutes, but that the bag is played quicker."""
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split("## Live")[1]
    run, play = (
        shlex.split(line) for line in re.findall(r"^pipeline-tracker (.*)$", page, re.MULTILINE)
    )
    assert (run[0], play) == ("run", ["play", "bags/demo"])
    nodes = bench.process(command(*run))
    nodes.wait_for(is_ready, "all nodes are ready")
    player = bench.process(command("play", str(ROOT / "bags" / "demo"), "--rate", "2"))
    seen = re.compile(r"\[pipe_tracker\]: \d+ ns: tracking \(")
    nodes.wait_for(lambda text: len(seen.findall(text)) >= 10, "ten frames are tracked")
    assert player.popen.wait(60.0) == 0
    assert "nobody listens" not in player.text


def test_the_player_tells_how_its_compressed_images_are_heard(bench: Any) -> None:
    code = "import pipeline_tracker.nodes.bag_player as player; player.MATCH_WITHIN = 0.3\n"
    demo = str(ROOT / "bags" / "demo")
    process = bench.process(code + command("play", demo, "--rate", "200"))
    assert process.popen.wait(60.0) == 0
    assert "(`run` does with --set image_transport=compressed); playing" in process.text


@pytest.mark.parametrize("waiting", [True, False], ids=["waiting", "playing"])
def test_a_signal_ends_it_with_130(bench: Any, bag: Path, waiting: bool) -> None:
    talker = bench.talker() if waiting else listener(bench)
    process = bench.process(command("play", str(bag), "--rate", "0.05"))
    if waiting:
        talker.wait(
            lambda: talker.node.count_publishers("/stereo/left/image_rect"), "the player is there"
        )
    else:
        talker.wait(lambda: talker.got["vnm/pose"], "it plays")
    code, seconds = process.end(signal.SIGINT)
    assert code == 130
    assert seconds < 2.0
    assert "Traceback" not in process.text
    assert "played" in process.text


def test_the_nodes_come_through_a_loop(bench: Any, bag: Path) -> None:
    scene = bench.scene
    overrides = [word for s in (*scene.settings, "use_sim_time=true") for word in ("--set", s)]
    nodes = bench.process(command("run", *overrides))
    nodes.wait_for(lambda text: text.count("]: ready") == 4, "all nodes are ready")
    talker = bench.talker()
    talker.hear("pipeline/relative_state", "pipeline_tracker_msgs/msg/RelativeState")
    talker.hear("pipeline/status", "pipeline_tracker_msgs/msg/TrackingStatus")
    player = bench.process(command("play", str(bag), "--loop", "--rate", "0.5"))
    stamps = {scene.stamp(k) for k in range(FRAMES)}

    def lap(number: int) -> dict[int, Any]:
        states = talker.got["pipeline/relative_state"]
        of_lap = [m for m in states if m.reset_counter == number]
        by_stamp = {messages.stamp_ns(m.header): m for m in of_lap}
        return {stamp: m for stamp, m in by_stamp.items() if stamp in stamps}

    talker.wait(lambda: len(lap(2)) >= 3, "three laps", within=120.0)
    code, _ = player.end(signal.SIGINT)
    assert code == 130
    assert "laps" in player.text
    laps = [lap(number) for number in range(3)]
    for following in laps[1:]:
        # Each lap is like the first one, from its first frame on.
        assert scene.stamp(0) in following
        for stamp in set(laps[0]) & set(following):
            following[stamp].reset_counter = 0
            assert following[stamp] == laps[0][stamp]
    first = next(m for m in talker.got["pipeline/status"] if m.reset_counter == 1)
    assert first.reason == "time went backward"
    assert nodes.end()[0] == 0
    assert "Traceback" not in nodes.text
