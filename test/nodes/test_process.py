"""What a live process sets up before ROS is there."""

from __future__ import annotations

import os
import signal
import threading
import xml.etree.ElementTree as ET
from typing import Any

import pytest

from pipeline_tracker.nodes import process
from pipeline_tracker.nodes.launcher import node_parameters, run
from pipeline_tracker.nodes.player import play
from pipeline_tracker.settings_io import load_settings


@pytest.fixture
def environment(monkeypatch: Any) -> Any:
    for name in (
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "FASTDDS_DEFAULT_PROFILES_FILE",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "ROS_LOCALHOST_ONLY",
    ):
        # Set first, so that it is restored whatever the test does.
        monkeypatch.setenv(name, "x")
        monkeypatch.delenv(name)
    return monkeypatch


def test_transport_is_set_up_for_images_and_this_computer(environment: Any) -> None:  # noqa: ARG001
    process.prepare_transport(local=True)
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    tree = ET.parse(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])
    sizes = [int(e.text or 0) for e in tree.iter() if e.tag.endswith("segment_size")]
    assert sizes == [32 * 1024 * 1024]


def test_what_the_user_has_set_is_kept(environment: Any) -> None:
    environment.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "/mine.xml")
    environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    process.prepare_transport(local=True)
    assert os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] == "/mine.xml"
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


def test_a_node_by_itself_is_discovered_as_ros_says(environment: Any) -> None:  # noqa: ARG001
    process.prepare_transport(local=False)
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ


def test_a_signal_ends_the_wait_with_the_code() -> None:
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        stop = process.Stop()
        stop.on_signals(130)
        assert stop.wait(0.0) is None
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM)).start()
        assert stop.wait(30.0) == 130
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@pytest.mark.parametrize("missing", ["rclpy", "pipeline_tracker_msgs"])
def test_without_ros_one_line_says_what_is_needed(
    monkeypatch: Any, tmp_path: Any, missing: str
) -> None:
    def import_module(name: str) -> None:
        if name.startswith(missing):
            raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr(process, "import_module", import_module)
    monkeypatch.setattr(process.Stop, "on_signals", lambda *_: None)
    with pytest.raises(process.RosMissingError, match=f"run needs ROS 2.*{missing}") as caught:
        run(None, ["pipe.diameter=0.6"], separate=False)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_rate_is_refused(tmp_path: Any, rate: float) -> None:
    with pytest.raises(process.PipelineTrackerError, match=f"--rate {rate:g}: expected"):
        play(tmp_path, rate, loop=False)


def test_play_refuses_what_is_no_bag(tmp_path: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(process.Stop, "on_signals", lambda *_: None)
    with pytest.raises(process.PipelineTrackerError, match="no such file"):
        play(tmp_path / "none", 1.0, loop=False)


def test_parameters_of_the_nodes_with_ros_s_own_from_a_file(tmp_path: Any) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    pipe.diameter: 0.6\n"
        "    qos_overrides:\n      /vnm/pose: {subscription: {reliability: reliable}}\n"
    )
    parameters = node_parameters(load_settings(file), file)
    assert parameters["pipe.diameter"] == 0.6
    assert parameters["qos_overrides./vnm/pose.subscription.reliability"] == "reliable"
    assert "camera.translation" not in parameters
