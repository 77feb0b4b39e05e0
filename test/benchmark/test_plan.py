from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from pipeline_tracker.benchmark import Plan, make_plan, read_manifest
from pipeline_tracker.benchmark.fingerprint import SIMULATOR
from pipeline_tracker.benchmark.plan import RunTask
from pipeline_tracker.simulation import list_scenarios
from pipeline_tracker.simulation.scenario_files import load_scenario

Write = Callable[..., Path]


@pytest.fixture
def plan(write_manifest: Write) -> Callable[..., Plan]:
    def make(text: str) -> Plan:
        path = write_manifest(text)
        return make_plan(read_manifest(path), path)

    return make


def settings_of(run: RunTask) -> dict[str, dict[str, object]]:
    return yaml.safe_load(run.settings)


def test_runs_are_scenarios_by_seeds_by_variants(plan: Callable[..., Plan]) -> None:
    made = plan(
        "runs: [{scenario: demo, seeds: [3, 1]}, {scenario: model_4m, variants: [b]}]\n"
        "variants: {a: {}, b: {tracking: {refine: false}}}"
    )
    own = load_scenario("model_4m").seed
    assert [run.label for run in made.runs] == [
        "demo, seed 3, a",
        "demo, seed 3, b",
        "demo, seed 1, a",
        "demo, seed 1, b",
        f"model_4m, seed {own}, b",
    ]
    assert [sea.label for sea in made.seas] == [
        "sea demo, seed 3",
        "sea demo, seed 1",
        f"sea model_4m, seed {own}",
    ]
    assert len({run.directory for run in made.runs}) == 5
    assert [settings_of(run)["tracking"]["refine"] for run in made.runs[:2]] == [True, False]


def test_the_nearest_override_wins(plan: Callable[..., Plan]) -> None:
    made = plan(
        "settings: {motion.window: 2.0, segment.length: 2.0, sync.queue: 2}\n"
        "runs: [{scenario: demo, settings: [motion.window=3.0, segment.length=3.0],"
        " set: {frames: 7, camera.width: 128}}]\n"
        "variants: {a: [segment.length=4.0]}"
    )
    (run,) = made.runs
    settings = settings_of(run)
    assert settings["sync"]["queue"] == 2
    assert settings["motion"]["window"] == 3.0
    assert settings["segment"]["length"] == 4.0
    assert run.sea is not None
    scenario = yaml.safe_load(run.sea.scenario)
    assert scenario["frames"] == 7
    assert (scenario["camera"]["width"], scenario["camera"]["height"]) == (128, 64)


def test_what_the_scenario_knows_is_not_to_be_repeated(plan: Callable[..., Plan]) -> None:
    made = plan("runs: [{scenario: mono, set: {pipe.diameter: 0.42}}]")
    settings = settings_of(made.runs[0])
    assert settings["pipe"]["diameter"] == 0.42
    assert settings["mode"] == "mono"
    geometry = made.runs[0].geometry
    assert geometry is not None
    assert geometry.diameter == 0.42
    assert geometry.baseline is None
    wrong = plan("runs: [{scenario: demo, settings: {pipe.diameter: 0.5}}]").runs[0]
    assert settings_of(wrong)["pipe"]["diameter"] == 0.5
    assert wrong.geometry is not None
    assert wrong.geometry.diameter == 0.6


def test_patterns(plan: Callable[..., Plan]) -> None:
    names = list(list_scenarios())
    assert [run.name for run in plan("runs: [{scenario: '*'}]").runs] == names
    made = plan("runs: [{scenario: 'm*', without: ['model_[0-9]m']}]")
    assert [run.name for run in made.runs] == [
        name for name in names if name.startswith("m") and not name.startswith("model_")
    ]


def test_paths_are_relative_to_the_manifest(
    plan: Callable[..., Plan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "seas").mkdir()
    (tmp_path / "seas" / "mine.yaml").write_text("frames: 9\n")
    (tmp_path / "bag").mkdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    made = plan("runs: [{scenario: seas/mine.yaml}, {bag: bag, settings: {pipe.diameter: 0.3}}]")
    assert [run.name for run in made.runs] == ["mine", "bag"]
    assert made.runs[1].bag == str(tmp_path / "bag")
    assert made.runs[1].seed is None
    assert made.runs[1].sea is None


def test_a_hash_changes_with_what_is_made_and_only_then(
    plan: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    def tasks(text: str) -> tuple[str, str]:
        (run,) = plan(text).runs
        assert run.sea is not None
        return run.sea.directory, run.directory

    sea, run = tasks("runs: [{scenario: demo}]")
    assert tasks("runs: [{scenario: demo, set: {description: other}}]") == (sea, run)
    assert tasks("runs: [{scenario: demo, seeds: [1]}]") == (sea, run)
    other_sea, other_run = tasks("runs: [{scenario: demo, set: {lamps.0.power: 2}}]")
    assert other_sea != sea
    assert other_run != run
    assert tasks("runs: [{scenario: demo, settings: [sync.queue=7]}]")[0] == sea
    assert tasks("runs: [{scenario: demo, settings: [sync.queue=7]}]")[1] != run
    monkeypatch.setattr("pipeline_tracker.benchmark.plan.measuring_code", lambda: "newer")
    assert tasks("runs: [{scenario: demo}]")[0] == sea
    assert tasks("runs: [{scenario: demo}]")[1] != run
    monkeypatch.setattr("pipeline_tracker.benchmark.plan.simulator_code", lambda: "newer")
    assert tasks("runs: [{scenario: demo}]")[0] != sea


def test_another_bag_is_another_run(plan: Callable[..., Plan], tmp_path: Path) -> None:
    text = "runs: [{bag: bag, settings: {pipe.diameter: 0.3}}]"
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "x.mcap"
    file.write_bytes(b"1")
    os.utime(file, ns=(10**9, 10**9))
    first = plan(text).runs[0].directory
    assert plan(text).runs[0].directory == first
    os.utime(file, ns=(10**9, 10**9 + 1))
    assert plan(text).runs[0].directory != first


def test_the_simulators_hash_covers_all_that_it_imports() -> None:
    """But for what reads settings: all values of a scenario are in a sea's hash anyway."""
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("pipeline_tracker")
    covered = {name.removesuffix(".py") for name in SIMULATOR}
    used = {
        upstream.split(".")[1]
        for module in graph.find_descendants("pipeline_tracker.simulation")
        for upstream in graph.find_upstream_modules(module)
        if upstream.count(".")
    }
    assert used - covered <= {"settings", "settings_io", "settings_rows"}
    assert covered - used <= {"simulation"}
