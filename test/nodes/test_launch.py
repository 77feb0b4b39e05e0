"""The launch file, with stand-ins for launch and launch_ros, which have no wheels."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from pipeline_tracker.errors import SettingsError

FILE = Path(__file__).resolve().parents[2] / "launch" / "pipeline_tracker.launch.py"


class Recorded:
    """Anything made of arguments."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments = arguments
        self.options = options

    def perform(self, context: dict[str, str]) -> str:
        return context[self.arguments[0]]


@pytest.fixture
def launch(monkeypatch: Any) -> Any:
    """Runs the launch file with arguments and returns its nodes."""
    contents = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for name, classes in contents.items():
        module = ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(FILE))["generate_launch_description"]()

    def run(**given: str) -> list[Any]:
        *declared, function = description.arguments[0]
        defaults = {d.arguments[0]: d.options["default_value"] for d in declared}
        assert set(given) <= set(defaults) == {"config", "namespace", "use_sim_time"}
        nodes: list[Any] = function.options["function"](defaults | given)
        return nodes

    return run


def test_four_nodes_with_the_settings_of_the_file(launch: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("pipe: {diameter: 0.6}\n")
    nodes = launch(config=str(file), namespace="auv", use_sim_time="True")
    assert [node.options["executable"] for node in nodes] == [
        "stereo_vectorizer",
        "local_recognizer",
        "pipe_tracker",
        "relative_state_publisher",
    ]
    for node in nodes:
        assert node.options["package"] == "pipeline_tracker"
        assert node.options["namespace"] == "auv"
        (parameters,) = node.options["parameters"]
        assert parameters["pipe.diameter"] == 0.6
        assert parameters["use_sim_time"] is True


def test_use_sim_time_is_the_file_s_where_it_is_not_given(launch: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("use_sim_time: true\npipe.diameter: 0.6\n")
    assert launch(config=str(file))[0].options["parameters"][0]["use_sim_time"] is True


def test_bad_settings_are_refused_before_a_node_is_started(launch: Any) -> None:
    with pytest.raises(SettingsError, match=r"pipe\.diameter is missing"):
        launch()
