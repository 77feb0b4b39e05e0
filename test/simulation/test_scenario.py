from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import SettingsError
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import (
    dump_scenario,
    list_scenarios,
    load_scenario,
)
from pipeline_tracker.simulation.simulator import build_sea


def test_the_demo_is_listed_with_a_description() -> None:
    assert "0.6 m pipe" in list_scenarios()["demo"]


def test_the_demo_is_what_the_readme_says() -> None:
    demo = load_scenario("demo")
    assert demo.pipe.diameter == 0.6
    assert demo.camera.baseline == 0.2
    assert demo.camera.field_of_view_deg == 65.5
    assert demo.frames == 20
    assert len(demo.lamps) == 1


@pytest.mark.parametrize(("name", "distance"), [("model_2m", 2.0), ("model_4m", 4.0)])
def test_the_model_scenes_are_the_papers(name: str, distance: float) -> None:
    scene = load_scenario(name)
    assert (scene.frames, scene.camera.width, scene.camera.height) == (80, 1200, 800)
    assert scene.path.distance == distance
    assert (scene.camera.baseline, scene.camera.field_of_view_deg) == (0.2, 65.5)
    sight = scene.camera.mounting().rotation[:, 2]
    np.testing.assert_allclose(sight, [0.5, 0.0, -np.sqrt(0.75)], atol=1e-9)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.baseline=-0.2", ["camera.baseline=-0.2", "greater than 0"]),
        ("camera.baseline=0", ["camera.baseline=0", "greater than 0"]),
        ("pipe.diameter=0", ["pipe.diameter=0", "greater than 0.02"]),
        ("pipe.diameter=.nan", ["pipe.diameter=nan", "finite"]),
        ("pipe.diameter=.inf", ["pipe.diameter=inf", "finite"]),
        ("pipe.diameter=wide", ["pipe.diameter='wide'", "number"]),
        ("pipe.diameter=true", ["pipe.diameter=true", "number"]),
        ("frames=0", ["frames=0", "greater than or equal to 1"]),
        ("frames=2.5", ["frames=2.5", "integer"]),
        ("seed=-1", ["seed=-1", "greater than or equal to 0"]),
        ("camera.translation=[0,0]", ["camera.translation"]),
        ("camera.translation=[0,0,.nan]", ["camera.translation", "finite"]),
        ("camera.encoding=rgb", ["camera.encoding='rgb'", "'bgr8' or 'mono8'"]),
        ("camera.mono=1", ["camera.mono=1", "boolean"]),
        ("camera.mismatch=-1", ["camera.mismatch=-1", "-0.9"]),
        ("camera.exposure_variation=-0.1", ["camera.exposure_variation=-0.1", "0"]),
        ("vnm.noise=-0.01", ["vnm.noise=-0.01", "greater than or equal to 0"]),
        ("vnm.dropouts=[{at: -1, duration: 1}]", ["vnm.dropouts.0.at=-1"]),
        ("vnm.dropouts=[{at: 1, duration: 0}]", ["vnm.dropouts.0.duration=0", "greater than 0"]),
        ("vnm.dropouts=[{at: 1}]", ["vnm.dropouts.0.duration", "required"]),
        ("vnm.dropouts=[{at: 19.5, duration: 1}]", ["vnm.dropouts.0.at=19.5 s", "at 19 s"]),
        (
            "sensors.altimeter_dropouts=[{at: 1, duration: 1}, {at: 99, duration: 1}]",
            ["sensors.altimeter_dropouts.1.at=99 s", "after the last pair"],
        ),
        ("sensors.altimeter_direction=[0,0,0]", ["altimeter_direction is a zero vector"]),
        ("path.manoeuvres=[{lateral: 1}]", ["path.manoeuvres.0.at", "required"]),
        ("path.manoeuvres=[{at: 1, sideways: 1}]", ["path.manoeuvres.0.sideways", "unknown key"]),
        ("path.speed_variation=1", ["path.speed_variation=1", "0.9"]),
        ("lamps=[]", ["lamps=[]", "at least 1"]),
        ("lamps.0.power=0", ["lamps.0.power=0", "greater than 0"]),
        ("lamps.0.direction=[0,0,0]", ["lamps.0", "direction is a zero vector"]),
        ("lamps.3.power=1", ["lamps.3.power", "'3' is not in the list"]),
        ("pipe.diametre=0.6", ["pipe.diametre", "unknown key", "did you mean pipe.diameter?"]),
        ("diameter=0.6", ["unknown key", "did you mean pipe.diameter?"]),
        ("pipe.diameter.x=0.6", ["diameter is a single value", "pipe.diameter?"]),
        ("zebra=1", ["zebra=1", "unknown key"]),
        ("lamps=[{position: [0, 0, 0], colour: [1, 1, 2]}]", ["lamps.0.colour.2=2"]),
        ("frames", ["expected key=value"]),
        ("frames=[1", ["frames", "not valid YAML"]),
    ],
)
def test_impossible_values_are_refused_in_one_line(override: str, words: list[str]) -> None:
    with pytest.raises(SettingsError) as refused:
        load_scenario("demo", [override])
    text = str(refused.value)
    assert "\n" not in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("path.distance=0.01", ["camera is", "from the pipe's surface", "path.distance=0.01"]),
        ("path.distance_sway=6", ["camera is", "below the bed", "path.distance_sway"]),
        ("bed.burial=1.5", ["camera is", "below the bed", "bed.burial"]),
        ("bed.drifts=[{at: 0, length: 5, width: 5, height: 5}]", ["below the bed", "bed.drifts"]),
        ("lamps.0.position=[0,0,-2.3]", ["lamps.0"]),
        ("bed.resolution=0.005", ["bed.resolution = 0.005", "coarser"]),
    ],
)
def test_cameras_and_lamps_stay_in_the_water(
    small: Callable[..., Scenario], override: str, words: list[str]
) -> None:
    # Coarse, so that the bed is quickly there; the last case sets its own.
    steps = ["bed.resolution=0.2", "frames=12", "path.sway_period=4"]
    if "burial" in override:
        steps.append("path.distance=0.2")
    scenario = small(*steps, "path.lateral_start=0", override)
    if "resolution" in override:
        scenario = small("frames=400", override)
    with pytest.raises(SettingsError) as refused:
        build_sea(scenario)
    text = str(refused.value)
    assert "\n" not in text
    for word in words:
        assert word in text


def test_an_override_keeps_what_stands_beside_it() -> None:
    plain = load_scenario("demo")
    changed = load_scenario("demo", ["lamps.0.power=2", "path.speed=1", "frames=3"], seed=9)
    assert changed.lamps[0].power == 2.0
    assert changed.lamps[0].position == plain.lamps[0].position
    assert (changed.path.speed, changed.frames, changed.seed) == (1.0, 3, 9)
    assert changed.bed == plain.bed


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("pipe: {diameter: 0.9}\nwater: {halo: 0}\n")
    scenario = load_scenario(file, ["path.speed=5e-1"])
    assert scenario.pipe.diameter == 0.9
    assert scenario.path.speed == 0.5
    assert scenario.camera == Scenario().camera


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.baseline=-0.2", "greater than 0"),
        ("pipe.diameter=0", "greater than 0.02"),
        ("frames=0", "greater than or equal to 1"),
        ("path.distance=.nan", "finite"),
        ("path.distance=0.01", "from the pipe's surface"),
        ("camera.fog=1", "unknown key"),
        ("vnm.dropouts=[{at: 40, duration: 1}]", "after the last pair at 19 s"),
    ],
)
def test_the_command_refuses_with_exit_code_2(
    override: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "sea"
    assert run_command(["simulate", "demo", "--output", str(output), "--set", override]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("pipeline-tracker: ")
    assert captured.err.count("\n") == 1
    assert words in captured.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1\n- 2\n", ["expected keys and values"]),
        ("pipe: 3\n", ["pipe=3"]),
        ("pipe: {diameter: [", ["not valid YAML"]),
        ("pipes: {diameter: 1}\n", ["pipes", "unknown key"]),
    ],
)
def test_a_file_that_is_no_scenario(tmp_path: Path, text: str, words: list[str]) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(SettingsError) as refused:
        load_scenario(file)
    for word in words:
        assert word in str(refused.value)


def test_an_unknown_scenario_names_those_there_are() -> None:
    with pytest.raises(SettingsError, match=r"'nosuch' is unknown; expected one of .*demo"):
        load_scenario("nosuch")


def test_a_dumped_scenario_reads_back(tmp_path: Path) -> None:
    scenario = load_scenario("demo", ["lamps.0.radius=0", "camera.jpeg_quality=null"])
    file = tmp_path / "again.yaml"
    file.write_text(dump_scenario(scenario))
    assert load_scenario(file) == scenario


def test_the_field_of_view_gives_the_focal_length() -> None:
    left, right = load_scenario("demo", ["camera.field_of_view_deg=90"]).camera.rig().cameras
    assert left.fx == pytest.approx(left.width / 2)
    # Half a pixel beyond the last centre is the border of the view.
    border = left.rays(np.array([left.width - 0.5, left.cy]))
    assert np.rad2deg(np.arctan2(border[0], border[2])) == pytest.approx(45.0)
    assert (left.offset, right.offset) == (0.0, 0.2)
