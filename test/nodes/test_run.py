"""`run`: processes, signals, refusals."""

from __future__ import annotations

import os
import re
import signal
from typing import Any

import pytest
from live_processes import (
    NODES,
    children_of,
    is_ready,
    known_to_all,
    module_of,
    run_command,
)
from processes import ends, is_alive

from pipeline_tracker.cli import run_command as command_line
from pipeline_tracker.messages import stamp_ns

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("separate", "number"),
    [(False, signal.SIGTERM), (False, signal.SIGINT), (True, signal.SIGTERM)],
    ids=["one process, SIGTERM", "one process, SIGINT", "four processes, SIGTERM"],
)
def test_a_signal_ends_all_with_code_0_and_no_words(
    bench: Any, separate: bool, number: int
) -> None:
    process = bench.process(run_command(bench.scene, *(["--separate"] if separate else [])))
    process.wait_for(is_ready, "all nodes are ready")
    children = children_of(process.popen.pid)
    assert len(children) == (4 if separate else 0)
    code, seconds = process.end(number)
    assert code == 0
    assert seconds < 2.0
    assert not any(map(is_alive, children))
    assert "Traceback" not in process.text
    assert "rror" not in process.text


def test_verbose_nodes_log_what_becomes_of_each_frame(bench: Any) -> None:
    process = bench.process(run_command(bench.scene, "--separate", "-v"))
    process.wait_for(is_ready, "all nodes are ready")
    state = bench.vehicle().approach(0)
    assert state.valid
    stamp = stamp_ns(state.header)
    for name in ("stereo_vectorizer", "pipe_tracker", "relative_state_publisher"):
        answered = re.compile(rf"\[DEBUG\] .*\[{name}\]: {stamp} ns: answered")
        process.wait_for(answered.search, f"{name} tells of the frame")
    told = re.search(
        rf"\[pipe_tracker\]: {stamp} ns: tracking .*, vectorized in .* ms, tracked in", process.text
    )
    assert told is not None
    assert "# settings in force" in process.text
    # DDS and rclpy are none of the user's business.
    assert not re.search(r"\[DEBUG\] .*\[(rcl|rmw)", process.text)
    assert process.end()[0] == 0


def test_quiet_nodes_say_nothing_while_all_is_well(bench: Any) -> None:
    recording = bench.directory / "recording"
    process = bench.process(run_command(bench.scene, "-q", "--record", str(recording)))
    vehicle = bench.vehicle()
    known_to_all(vehicle)
    assert vehicle.approach(0).valid
    assert process.end()[0] == 0
    assert process.text == ""
    assert recording.is_dir()


def test_a_signal_while_starting_ends_it_as_well(bench: Any) -> None:
    code = (
        "import pipeline_tracker.pipeline as p, time\n"
        "def warm_up(stage):\n"
        "    print('warming', flush=True)\n"
        "    time.sleep(600)\n"
        "p.warm_up = warm_up\n"
    )
    process = bench.process(code + run_command(bench.scene))
    process.wait_for(lambda text: "warming" in text, "kernels are compiled")
    code_, seconds = process.end()
    assert code_ == 0
    assert seconds < 2.0
    assert "Traceback" not in process.text


def test_children_do_not_outlive_a_parent_that_is_killed(bench: Any) -> None:
    process = bench.process(run_command(bench.scene, "--separate"))
    process.wait_for(is_ready, "all nodes are ready")
    children = children_of(process.popen.pid)
    assert len(children) == 4
    process.end(signal.SIGKILL)
    for child in children:
        assert ends(child, within=10.0), "a child lives on"


def test_whichever_child_is_killed_is_started_again_and_output_comes_back(bench: Any) -> None:
    process = bench.process(run_command(bench.scene, "--separate", "--set", "output.timeout=1.0"))
    process.wait_for(is_ready, "all nodes are ready")
    vehicle = bench.vehicle()
    assert vehicle.approach(0).valid
    got = vehicle.talker.got["pipeline/relative_state"]
    for k, names in enumerate((NODES[::2], NODES[1::2]), 1):
        children = children_of(process.popen.pid)
        victims = {pid for pid in children if module_of(pid).rsplit(".")[-1] in names}
        assert len(victims) == 2
        for victim in victims:
            os.kill(victim, signal.SIGKILL)
        for name in names:
            process.wait_for(lambda text, n=name: f"{n} ended with exit code -9" in text, "noticed")
            process.wait_for(lambda text, n=name: text.count(f"[{n}]: ready") == 2, "it is back")
        # The others go on, and what was valid is not meanwhile.
        assert set(children) - victims < set(children_of(process.popen.pid))
        vehicle.talker.wait(lambda: got and not got[-1].valid, "invalid meanwhile")
        assert vehicle.approach(k).valid
    assert process.end()[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run"], "pipe.diameter is missing"),
        (["run", "--set", "pipe.diameter=0.6"], "camera's mounting is not known"),
        (["run", "--set", "pipe.diameter=.nan"], "pipe.diameter=nan"),
        (["run", "--config", "/no/such/file.yaml"], "no such settings file"),
        (["play", "/no/such/bag"], "no such file or directory"),
        (["play", "/no/such/bag", "--rate", "0"], "--rate 0: expected a number above 0"),
    ],
)
def test_bad_input_is_one_line_and_code_2(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert command_line(arguments) == 2
    lines = "".join(capfd.readouterr()).strip().splitlines()
    assert len(lines) == 1, lines
    assert words in lines[0]


@pytest.mark.parametrize("missing", ["pipe.diameter", "mounting"])
def test_a_node_by_itself_refuses_in_one_line(bench: Any, missing: str) -> None:
    arguments = [] if missing == "pipe.diameter" else ["-p", "pipe.diameter:=0.6"]
    code = (
        "import sys; from pipeline_tracker.nodes.pipe_tracker import main\n"
        f"sys.exit(main(['--ros-args', *{arguments!r}]))"
    )
    process = bench.process(code)
    assert process.popen.wait(60.0) == 2
    lines = process.text.strip().splitlines()
    assert len(lines) == 1, lines
    assert missing in lines[0]
    assert "[pipe_tracker]" in lines[0]


def test_namespace_and_remapping_from_the_command_line(bench: Any) -> None:
    arguments = ["--ros-args", "-r", "__ns:=/auv", "-r", "vnm/pose:=/nav/pose"]
    process = bench.process(run_command(bench.scene, *arguments))
    process.wait_for(lambda text: text.count("]: ready") == 4, "all nodes are ready")
    vehicle = bench.vehicle("/auv")
    kind = "geometry_msgs/msg/PoseStamped"
    vehicle.talker.close_topic("vnm/pose")
    vehicle.talker._publishers["vnm/pose"] = vehicle.talker.publisher("/nav/pose", kind)
    assert vehicle.approach(0).valid
    assert vehicle.drive(1).valid
    assert process.end()[0] == 0
