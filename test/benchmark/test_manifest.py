from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline_tracker.benchmark import make_plan, read_manifest
from pipeline_tracker.benchmark.manifest import find_manifest
from pipeline_tracker.errors import ManifestError

Write = Callable[..., Path]
RUN = "runs: [{scenario: demo}]\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "holds (empty), expected a manifest with `runs:` in it"),
        ("- demo", "holds ['demo'], expected a manifest"),
        ("runs: [", "not valid YAML in line"),
        ("description: x", "runs is missing; expected a list of scenarios or bags"),
        ("runs: []", "runs=[]: "),
        ("runs: [demo]", "runs.0="),
        (RUN + "run: 3", "run=3: unknown key; did you mean runs?"),
        ("runs: [{scenari: demo}]", "runs.0.scenari='demo': unknown key; did you mean scenario?"),
        ("runs: [{}]", "runs.0: expected either `scenario: NAME` or `bag: PATH`"),
        ("runs: [{scenario: demo, bag: x}]", "runs.0: expected either"),
        ("runs: [{scenario: 3}]", "runs.0.scenario=3: expected a valid string"),
        ("runs: [{bag: x, seeds: [1]}]", "runs.0: seeds is for a scenario; a bag is as it is"),
        ("runs: [{bag: x, set: {frames: 3}}]", "runs.0: set is for a scenario"),
        ("runs: [{scenario: demo, without: [x]}]", "runs.0: without is for a pattern"),
        ("runs: [{scenario: '*', name: x}]", "runs.0: a pattern of scenarios takes no name"),
        ("runs: [{scenario: demo, seeds: []}]", "runs.0.seeds=[]"),
        ("runs: [{scenario: demo, seeds: [-1]}]", "runs.0.seeds.0=-1: expected greater than"),
        ("runs: [{scenario: demo, seeds: [1, 2, 1]}]", "runs.0: seeds has 1 twice"),
        ("runs: [{scenario: demo, seeds: [1.5]}]", "runs.0.seeds.0=1.5: expected a valid integer"),
        ("runs: [{scenario: demo, name: 'a/b'}]", "runs.0.name='a/b': expected a name of letters"),
        ("runs: [{scenario: demo, set: 3}]", "runs.0.set=3: expected keys and values, or a list"),
        (RUN + "settings: [3]", "settings.0=3"),
        (RUN + "variants: {}", "variants={}"),
        (RUN + "variants: {a b: {}}", "expected a name of letters"),
        (RUN + "variants: {a: 3}", "variants.a=3: expected keys and values"),
        ("runs: [{scenario: demo, variants: [x]}]", "runs.0.variants has x, which is none of"),
        (RUN + "variants: {a: {}, a: {}}", "not valid YAML in line 2"),
    ],
)
def test_refused_as_it_is_read(write_manifest: Write, text: str, line: str) -> None:
    path = write_manifest(text, tiny=False)
    with pytest.raises(ManifestError) as caught:
        read_manifest(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("runs: [{scenario: dmeo}]", "runs.0.scenario=dmeo: there is no such scenario and no file"),
        ("runs: [{scenario: 'x*'}]", "no scenario is called x*; there are "),
        ("runs: [{scenario: '*', without: [x]}]", "no scenario is called x; there are "),
        ("runs: [{bag: nowhere}]", "runs.0.bag=nowhere: there is no "),
        ("runs: [{scenario: demo, set: {frames: 0}}]", "scenario demo: frames=0: expected"),
        ("runs: [{scenario: demo, set: {frame: 2}}]", "unknown key; did you mean frames?"),
        (RUN + "settings: {pipe.diameter: -1}", "pipe.diameter=-1: expected a number, above 0"),
        (RUN + "variants: {x: {recognition.technique: 7}}", "variant x: recognition.technique=7"),
        (RUN + "variants: {x: {recognition.tech: 1}}", "did you mean recognition.technique?"),
        ("runs: [{scenario: demo}, {scenario: demo}]", "runs.1: demo, seed 1, default is there"),
        ("runs: [{scenario: demo}, {scenario: demo, seeds: [1]}]", "already, by runs.0; give one"),
        ("runs: [{bag: bench.yaml}]", "runs.0, variant default: pipe.diameter is missing"),
        (
            "runs: [{scenario: demo, seeds: [1, 2, 3]}]\nvariants: {a: {}, A: {}}",
            "demo, seed 1, A is there already",
        ),
    ],
)
def test_refused_before_the_work(write_manifest: Write, text: str, line: str) -> None:
    path = write_manifest(text, tiny=False)
    with pytest.raises(ManifestError) as caught:
        make_plan(read_manifest(path), path)
    assert str(caught.value).startswith(f"{path}: runs.")
    assert line in str(caught.value)
    assert "--set" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_too_many_runs(write_manifest: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline_tracker.benchmark.plan._MOST_RUNS", 3)
    path = write_manifest("runs: [{scenario: demo, seeds: [1, 2, 3, 4]}]")
    with pytest.raises(ManifestError, match="more than 3 runs"):
        make_plan(read_manifest(path), path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="no such manifest"):
        read_manifest(tmp_path / "nothing.yaml")


def test_huge_file(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    path.write_text("#" * 1_000_001)
    with pytest.raises(ManifestError, match="larger than 1000000 bytes"):
        read_manifest(path)


def test_a_directory_does_not_hide_a_manifest_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("all").mkdir()
    assert read_manifest(find_manifest(Path("all"))).runs


@pytest.mark.parametrize("name", ["ablation", "all", "seeds", "techniques"])
def test_those_that_come_with_the_package(name: str) -> None:
    path = find_manifest(Path(name))
    plan = make_plan(read_manifest(path), path)
    assert plan.runs
    assert plan.seas
