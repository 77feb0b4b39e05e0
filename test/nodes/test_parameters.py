"""Settings as ROS parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipeline_tracker.errors import CalibrationError, SettingsError
from pipeline_tracker.settings_rows import describe_settings

pytestmark = pytest.mark.ros

MOUNTING = {
    "camera.translation": [0.0, 0.0, 0.0],
    "camera.rotation_rpy": [3.1416, 0.0, -1.5708],
}


@pytest.fixture
def make(domain: int) -> Any:
    """Makes configured trackers in a domain of their own."""
    import rclpy
    from rclpy.lifecycle import TransitionCallbackReturn

    from pipeline_tracker.nodes.pipe_tracker import PipeTracker

    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    nodes = []

    def make(parameters: dict[str, Any], arguments: list[str] | None = None) -> Any:
        cli = ["--ros-args", *arguments] if arguments else None
        nodes.append(PipeTracker(parameters, context=context, cli_args=cli))
        if nodes[-1].trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise nodes[-1].failure
        return nodes[-1]

    yield make
    for node in nodes:
        node.close()
        node.destroy_node()
    context.try_shutdown()


def test_every_setting_is_a_parameter_with_description_and_range(make: Any) -> None:
    node = make({"pipe.diameter": 0.6, **MOUNTING})
    for row in describe_settings():
        assert node.has_parameter(row.key), row.key
        if row.key == "use_sim_time":
            continue
        descriptor = node.describe_parameter(row.key)
        assert descriptor.description == row.description
        if row.maximum is not None and row.kind == "number":
            assert descriptor.floating_point_range[0].to_value == row.maximum
    diameter = node.describe_parameter("pipe.diameter")
    assert diameter.additional_constraints == "m, above 0, at most 10"


def test_values_come_through_and_integers_are_taken_for_numbers(make: Any) -> None:
    node = make({"pipe.diameter": 1, "camera.translation": [1, 2, 3], **_rotation()})
    assert node.settings.pipe.diameter == 1.0
    assert node.get_parameter("pipe.diameter").value == 1.0
    assert isinstance(node.get_parameter("pipe.diameter").value, float)
    assert list(node.get_parameter("camera.translation").value) == [1.0, 2.0, 3.0]
    assert node.get_parameter("recognition.technique").value == "auto"


def _rotation() -> dict[str, Any]:
    return {"camera.rotation_rpy": MOUNTING["camera.rotation_rpy"]}


def test_parameters_are_settled_at_the_start(make: Any) -> None:
    from rclpy.parameter import Parameter

    node = make({"pipe.diameter": 0.6, **MOUNTING})
    (result,) = node.set_parameters([Parameter("pipe.diameter", value=0.7)])
    assert not result.successful
    assert node.get_parameter("pipe.diameter").value == 0.6


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "pipe.diameter is missing"),
        ({"pipe.diameter": -1.0}, "pipe.diameter=-1.0: expected a number, above 0"),
        ({"pipe.diameter": float("nan")}, "pipe.diameter=nan"),
        ({"pipe.diameter": "wide"}, "pipe.diameter='wide'"),
        ({"pipe.diametre": 0.6}, "did you mean pipe.diameter?"),
        ({"pipe.diameter": 0.6, "camera.translation": [1.0, 2.0]}, "camera.translation=[1.0, 2.0]"),
        ({"pipe.diameter": 0.6, "recognition.technique": 7}, "recognition.technique=7"),
        ({"pipe.diameter": 0.6, "use_sim_time": 1}, "use_sim_time=1"),
    ],
)
def test_a_bad_parameter_is_refused_in_one_line(
    make: Any, parameters: dict[str, Any], words: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        make(parameters)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_mounting_the_node_refuses(make: Any, monkeypatch: Any) -> None:
    from pipeline_tracker.nodes import mounting

    monkeypatch.setattr(mounting, "find_spec", lambda _: None)
    with pytest.raises(CalibrationError, match="tf2_msgs is not") as caught:
        make({"pipe.diameter": 0.6})
    assert "\n" not in str(caught.value)
    with pytest.raises(SettingsError, match=r"given without camera\.rotation_rpy"):
        make({"pipe.diameter": 0.6, "camera.translation": [0.0, 0.0, 0.0]})


def test_a_parameter_file_and_use_sim_time(make: Any, tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n"
        "  ros__parameters:\n"
        "    use_sim_time: true\n"
        "    pipe: {diameter: 0.5}\n"
        "    camera.translation: [0, 0, -1]\n"
        "    camera.rotation_rpy: [3.1416, 0.0, -1.5708]\n"
        "pipe_tracker:\n"
        "  ros__parameters:\n"
        "    recognition: {technique: 2}\n"
    )
    node = make({}, ["--params-file", str(file)])
    assert node.settings.pipe.diameter == 0.5
    assert node.settings.recognition.technique == 2
    assert node.settings.use_sim_time
    assert node.get_clock().ros_time_is_active
    # The clock of a simulation that has not begun.
    assert node.get_clock().now().nanoseconds == 0


def test_the_default_file_is_a_parameter_file(make: Any) -> None:
    from pipeline_tracker.resources import config_path

    node = make(
        {"pipe.diameter": 0.6, **MOUNTING}, ["--params-file", str(config_path("default.yaml"))]
    )
    assert node.settings.sync.tolerance == 0.002
