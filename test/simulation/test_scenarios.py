"""The scenarios that come with the package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import SettingsError
from pipeline_tracker.evaluation.truth import read_truth
from pipeline_tracker.resources import config_directory
from pipeline_tracker.settings import Settings
from pipeline_tracker.simulation import simulate
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import list_scenarios, load_scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.truth import OUTSIDE, VISIBLE, frame_contours, stretch_in_view

NAMES = sorted(file.stem for file in (config_directory() / "scenarios").glob("*.yaml"))
TINY = ("camera.width=96", "camera.height=64", "bed.resolution=0.08", "frames=2", "stretch=0")


def flags(sea: Sea, time: float) -> np.ndarray:
    base = sea.motion.pose(time)
    camera, pose = sea.scenario.camera.rig().left, base @ sea.mountings()[0]
    s = stretch_in_view(sea.scene.axis, (camera,), (pose,))
    return frame_contours(sea.scene.axis, sea.scene.caster, camera, pose, s).flags


@pytest.mark.parametrize("name", NAMES)
def test_each_scenario_loads_and_shows_a_picture(name: str) -> None:
    assert 20 < len(list_scenarios()[name]) < 110
    sea = build_sea(load_scenario(name, TINY))
    picture = sea.picture(0, 0)
    image = sea.sensor.expose(picture.light, np.random.default_rng(1))
    assert np.isfinite(picture.light).all()
    # Neither black nor white, and with something in it.
    assert 8 < image.mean() < 200
    assert image.std() > 2
    assert (image == 255).mean() < 0.02
    assert (picture.coverage > 0).any() == sea.scenario.pipe.present


def test_silt_buries_a_stretch_and_leaves_the_rest() -> None:
    sea = build_sea(load_scenario("silted", ["camera.width=192", "camera.height=128"]))
    shares = []
    for time in (0.0, 10.0, 36.0):
        found = flags(sea, time)
        shares.append((found == VISIBLE).sum() / (found != OUTSIDE).sum())
    assert shares[0] > 0.3
    assert shares[1] < 0.2
    assert shares[2] > 0.5
    # Wholly buried: the bed lies above the pipe's top.
    s = np.arange(0.0, 8.0, 0.05)
    top = sea.scene.axis.points(s) + np.array([0.0, 0.0, 0.3])
    under = sea.scene.bed.height_at(top) > top[:, 2]
    assert 0.8 < 0.05 * under.sum() < 2.5


def test_the_bend_has_its_radius() -> None:
    axis = build_sea(load_scenario("bend", TINY)).scene.axis
    heading = np.unwrap(np.arctan2(*axis.tangents(np.arange(0.0, 8.01, 0.5)).T[[1, 0]]))
    assert 8.0 / (heading[-1] - heading[0]) == pytest.approx(20.0, rel=0.15)


def test_the_free_pipe_hangs_above_the_bed_and_climbs() -> None:
    scene = build_sea(load_scenario("freespan", TINY)).scene
    s = np.arange(0.0, 7.0, 0.1)
    bottom = scene.axis.points(s) - np.array([0.0, 0.0, 0.3])
    gap = bottom[:, 2] - scene.bed.height_at(bottom)
    assert gap.mean() > 0.15
    assert gap.max() > 0.3
    slope = np.rad2deg(np.arcsin(scene.axis.tangents(s)[:, 2]))
    assert slope.mean() == pytest.approx(5.0, abs=3.0)


def test_fewer_frames_see_the_same_sea() -> None:
    few, many = (build_sea(load_scenario("clear", [*TINY[:3], f"frames={n}"])) for n in (2, 5))
    for index in (0, 1):
        assert np.array_equal(few.picture(1, index).light, many.picture(1, index).light)


def test_a_bend_that_closes_is_refused() -> None:
    scenario = load_scenario("bend", [*TINY, "frames=300"])
    with pytest.raises(SettingsError, match=r"pipe.curve_radius=20: .* come round"):
        build_sea(scenario)
    with pytest.raises(SettingsError, match=r"pipe\.curve_radius=2\.0: expected at least 3"):
        load_scenario("bend", ["pipe.curve_radius=2.0"])


def test_a_scenario_that_extends_another(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "extends: turbid\nwater: {halo: 0.1}\nlamps: [{power: 2}]\n"
    )
    (tmp_path / "more.yaml").write_text("extends: mine.yaml\npipe: {diameter: 0.4}\n")
    more, turbid = load_scenario(tmp_path / "more.yaml"), load_scenario("turbid")
    assert (more.pipe.diameter, more.water.halo) == (0.4, 0.1)
    assert more.water.attenuation == turbid.water.attenuation
    assert [lamp.power for lamp in more.lamps] == [2.0]
    assert more.frames == load_scenario("clear").frames


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("extends: mine.yaml\n", "extends goes in a circle (mine -> mine)"),
        ("extends: other.yaml\n", "extends goes in a circle (mine -> other -> mine)"),
        ("extends: nosuch\n", "'nosuch' is unknown"),
        ("extends: [clear]\n", "expected the name of a scenario"),
        ("extends: 3\n", "expected the name of a scenario"),
        ("water: {extends: clear}\n", "unknown key"),
    ],
)
def test_what_cannot_be_extended(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    (tmp_path / "other.yaml").write_text("extends: mine.yaml\n")
    with pytest.raises(SettingsError) as refused:
        load_scenario(tmp_path / "mine.yaml")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_sea_without_a_pipe_has_an_empty_truth(tmp_path: Path) -> None:
    bag = simulate("nopipe", tmp_path / "sea", TINY, progress=False)
    with BagReader(bag) as reader:
        lines = [r.unpack() for r in reader.records(["/ground_truth/centerline"])]
        clouds = [r.unpack() for r in reader.records(["/ground_truth/contours/left"])]
    assert [len(line.poses) for line in lines] == [0, 0]
    assert [(c.height, c.width, len(c.data)) for c in clouds] == [(2, 0, 0), (2, 0, 0)]
    truth = read_truth(bag, Settings.model_validate({"pipe": {"diameter": 0.6}}))
    assert truth.detectable is not None
    assert not any(truth.detectable.values())


def test_the_coating_comes_off_in_patches(small: Callable[..., Scenario]) -> None:
    quiet = ("bed.stones=0", "pipe.growth=0", "pipe.sediment=0")
    whole, damaged = (
        build_sea(small(*quiet, f"pipe.damage={share}")).picture(0, 0) for share in (0.0, 0.3)
    )
    on_pipe = whole.coverage == 1.0
    assert np.array_equal(whole.light[whole.coverage == 0], damaged.light[whole.coverage == 0])
    changed = np.abs(damaged.light - whole.light).max(axis=-1) > 0.02 * whole.light.max(axis=-1)
    assert 0.1 < changed[on_pipe].mean() < 0.6
    # Rust: redder than the coating.
    redness = (damaged.light[..., 0] / damaged.light[..., 2])[on_pipe & changed]
    assert np.mean(redness) > 1.5 * np.mean((whole.light[..., 0] / whole.light[..., 2])[on_pipe])
