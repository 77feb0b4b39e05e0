"""Whole benchmarks of tiny seas."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from rich.console import Console

from pipeline_tracker.benchmark import benchmark_command
from pipeline_tracker.benchmark.command import BenchmarkOutcome
from pipeline_tracker.benchmark.results import read_run
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import ManifestError
from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
Write = Callable[..., Path]


def bench(manifest: Path, output: Path, **options: object) -> tuple[BenchmarkOutcome, str]:
    """Run a benchmark; return what came of it, and what was said meanwhile."""
    told = io.StringIO()
    outcome = benchmark_command(
        manifest,
        output,
        console=Console(file=io.StringIO()),
        progress=Console(file=told, width=1000),
        **options,  # type: ignore[arg-type]
    )
    return outcome, told.getvalue()


def records(output: Path) -> list[dict[str, str]]:
    with (output / "benchmark.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def done_at(output: Path) -> dict[str, int]:
    """Return when each finished bag and run was written."""
    files = [*output.glob("seas/*/sea.json"), *output.glob("runs/*/run.json")]
    return {file.parent.name: file.stat().st_mtime_ns for file in files}


def unfinished(output: Path) -> list[Path]:
    return [*output.glob("seas/.*"), *output.glob("runs/.*")]


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert process.poll() is None, "it ended before"
        assert time.monotonic() < end, "it did not come in time"
        time.sleep(0.005)


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline_tracker.cli", "benchmark", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the tasks here: another process would first import and load all that is here already."""

    @contextmanager
    def pool(_: int) -> Iterator[tuple[Executor, int]]:
        with ThreadPoolExecutor(1) as executor:
            yield executor, 1

    monkeypatch.setattr("pipeline_tracker.benchmark.command.local_pool", pool)


def test_two_jobs_and_a_failing_one(write_manifest: Write, tmp_path: Path) -> None:
    bag = simulate(
        "demo",
        tmp_path / "dive",
        ["frames=2", "camera.width=96", "camera.height=64", "bed.resolution=0.1"],
        progress=False,
    )
    (tmp_path / "broken").mkdir()
    shutil.copy(bag / "metadata.yaml", tmp_path / "broken")
    manifest = write_manifest(
        "runs:\n"
        "- {scenario: demo, seeds: [1, 2]}\n"
        "- {scenario: demo, name: buried, set: {path.distance_sway: 9}, variants: [default]}\n"
        "- {bag: dive, variants: [alone]}\n"
        "- {bag: broken, settings: [pipe.diameter=0.6], variants: [default]}\n"
        "variants: {default: {}, alone: {recognition.only: true}}\n"
    )
    output = tmp_path / "out"
    outcome, told = bench(manifest, output, jobs=2)
    assert not outcome.whole
    assert not outcome.interrupted
    lines = {(r["name"], r["seed"], r["variant"]): r for r in records(output)}
    states = {key: record["state"] for key, record in lines.items()}
    assert states == {
        ("demo", "1", "default"): "done",
        ("demo", "2", "default"): "done",
        ("demo", "2 seeds", "default"): "pooled",
        ("demo", "1", "alone"): "done",
        ("demo", "2", "alone"): "done",
        ("demo", "2 seeds", "alone"): "pooled",
        ("buried", "1", "default"): "failed",
        ("dive", "", "alone"): "done",
        ("broken", "", "default"): "failed",
    }
    reason = lines["buried", "1", "default"]["reason"]
    assert reason.startswith("simulate: at ")
    assert "change path.distance" in reason
    assert "broken" in lines["broken", "", "default"]["reason"]
    assert lines["demo", "2 seeds", "default"]["frames"] == "4"
    # The bag says itself what it was made with.
    for name in ("camera", "baseline_m", "mounting", "lamps", "distance_m", "diameter_m"):
        assert lines["dive", "", "alone"][name] == lines["demo", "1", "alone"][name] != ""
    # The same figures as the commands one by one.
    (run,) = output.glob("runs/demo-1-alone-*")
    result = read_run(run)
    assert result is not None
    sea = Path(result.evaluation.truth)
    assert sea.parent == (output / "seas").resolve()
    assert evaluate(run, sea).groups == result.evaluation.groups
    assert len(re.findall(r"process (\d+)", told)) >= 8
    assert len(set(re.findall(r"process (\d+)", told))) == 2
    assert not unfinished(output)

    # Again: only what failed.
    before = done_at(output)
    _, told = bench(manifest, output, jobs=1)
    assert "runs: 7, done before: 5, to do: 2; seas to simulate: 1" in told
    assert done_at(output) == before


def test_killed_twice_and_run_again(write_manifest: Write, tmp_path: Path) -> None:
    manifest = write_manifest(
        "runs: [{scenario: demo, set: {frames: 12}}]\n"
        "variants: {a: {}, b: {sync.queue: 7}, c: {sync.queue: 6}}\n"
    )
    output = tmp_path / "out"
    # While the sea is rendered.
    process = start(manifest, "--output", output)
    wait_for(lambda: [*output.glob("seas/.unfinished-*/.*/*/*.mcap")], process)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert unfinished(output)
    assert not done_at(output)
    # While runs are replayed.
    process = start(manifest, "--output", output)
    wait_for(lambda: [*output.glob("runs/*/run.json")], process)
    process.kill()
    process.communicate()
    before = done_at(output)
    runs = len([*output.glob("runs/*/run.json")])
    assert len(before) == 1 + runs
    assert 1 <= runs < 3
    # To the end.
    process = start(manifest, "--output", output)
    _, errors = process.communicate(timeout=200)
    assert process.returncode == 0, errors
    assert f"runs: 3, done before: {runs}, to do: {3 - runs}; seas to simulate: 0" in errors
    after = done_at(output)
    assert {name: after[name] for name in before} == before
    assert [r["state"] for r in records(output)] == ["done"] * 3
    assert not unfinished(output)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted(write_manifest: Write, tmp_path: Path, number: int) -> None:
    manifest = write_manifest(
        "runs: [{scenario: demo, variants: [a]}, {scenario: demo, name: long, set: {frames: 500}}]"
        "\nvariants: {a: {}}\n"
    )
    output = tmp_path / "out"
    process = start(manifest, "--output", output, "--jobs", "2")
    wait_for(lambda: [*output.glob("runs/demo-*/run.json")], process)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    last = errors.splitlines()[-1]
    assert last.startswith("pipeline-tracker: interrupted; what is done is in ")
    assert "Traceback" not in errors
    assert [r["state"] for r in records(output)] == ["done", "not done"]


@pytest.mark.usefixtures("in_this_process")
def test_a_result_that_cannot_be_read_is_made_again_and_by_force_any(
    write_manifest: Write, tmp_path: Path
) -> None:
    manifest, output = write_manifest("runs: [{scenario: demo}]"), tmp_path / "out"
    assert run_command(["benchmark", str(manifest), "--output", str(output)]) == 0
    (run,) = output.glob("runs/*/run.json")
    run.write_text(run.read_text()[:20])
    assert "runs: 1, done before: 0, to do: 1; seas to simulate: 0" in bench(manifest, output)[1]
    assert records(output)[0]["state"] == "done"
    # By force: the run, not the sea.
    before = done_at(output)
    assert bench(manifest, output, force=True)[0].whole
    after = done_at(output)
    (sea,) = (directory.name for directory in (output / "seas").iterdir())
    assert before.keys() == after.keys()
    assert [name for name in before if after[name] == before[name]] == [sea]


def test_a_directory_of_something_else_is_refused(write_manifest: Write, tmp_path: Path) -> None:
    manifest = write_manifest("runs: [{scenario: demo}]")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter").touch()
    with pytest.raises(ManifestError, match=r"mine: is not empty \(it has letter\)"):
        bench(manifest, tmp_path / "mine")
    with pytest.raises(ManifestError, match="is a file"):
        bench(manifest, manifest)


def test_one_benchmark_at_a_time(write_manifest: Write, tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    output = tmp_path / "out"
    output.mkdir()
    (output / ".benchmark").touch()
    with (output / ".lock").open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        with pytest.raises(ManifestError, match="another benchmark is at work in it"):
            bench(write_manifest("runs: [{scenario: demo}]"), output)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nothing.yaml"], "nothing.yaml: no such manifest"),
        (["all", "--jobs", "0"], "--jobs 0: expected 1 to 256"),
        (["all", "--jobs", "two"], "--jobs two: expected an integer"),
        (["all", "--jobs", "2", "--scheduler", "tcp://x:1"], "expected one of them"),
        ([], "missing argument 'MANIFEST'"),
    ],
)
def test_wrong_commands(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["benchmark", *arguments]) == 2
    errors = capsys.readouterr().err
    assert line in errors
    assert errors.count("\n") == 1


@pytest.mark.usefixtures("in_this_process")
def test_a_failed_run_gives_exit_code_1(
    write_manifest: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "out")
    manifest = write_manifest("runs: [{scenario: demo, set: {path.distance_sway: 9}}]")
    assert run_command(["benchmark", str(manifest), "--output", output]) == 1
    assert "failed: simulate: at" in " ".join(capsys.readouterr().out.split())
