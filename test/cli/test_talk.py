"""-q and -v: how much a command tells."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bag_maker import write_bag

from pipeline_tracker.cli import run_command

DIAMETER = ["--set", "pipe.diameter=0.6"]


@pytest.fixture(autouse=True)
def dive(elsewhere: Path) -> None:
    """Work beside a small bag."""
    write_bag(elsewhere / "dive")


def told(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> tuple[str, str]:
    assert run_command(arguments) == code
    captured = capsys.readouterr()
    return captured.out, captured.err


def test_a_quiet_replay_says_nothing_and_does_the_same(
    capsys: pytest.CaptureFixture[str],
) -> None:
    usual, _ = told(capsys, "replay", "dive", *DIAMETER, "--output", "usual")
    assert "pipe found in 4" in usual
    assert told(capsys, "replay", "dive", *DIAMETER, "--output", "quiet", "-q") == ("", "")
    assert {p.name for p in Path("quiet").iterdir()} == {p.name for p in Path("usual").iterdir()}


def test_a_verbose_replay_tells_settings_and_times(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = told(capsys, "replay", "dive", *DIAMETER, "--set", "segment.length=0.7", "-v")
    assert "dive: 4 frames, pipe found in 4 (100 %)" in out
    assert "# settings in force" in err
    assert "pipe: {diameter: 0.6}" in err
    assert "segment: {length: 0.7}" in err
    for step in ("vectorization", "recognition", "tracking"):
        assert f"\n{step}: median " in err
    assert "\ntook " in err


@pytest.mark.parametrize("kept", [True, False])
def test_the_minutes_of_the_first_start_are_explained(
    kept: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pipeline_tracker.replay.runner.kernels_are_kept", lambda: kept)
    out, _ = told(capsys, "replay", "dive", *DIAMETER)
    assert out.startswith("dive: 4 frames" if kept else "compiling kernels, once after an install")


def test_both_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    _, err = told(capsys, "info", "dive", "-q", "-v", code=2)
    assert err == "pipeline-tracker: --quiet and --verbose: expected one of them\n"


def test_errors_are_told_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = told(capsys, "replay", "none", *DIAMETER, "-q", code=2)
    assert out == ""
    assert err.startswith("pipeline-tracker: none: no such file or directory")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["info", "dive"], 0),
        (["salvage", "dive", "--output", "whole"], 0),
        (["report", "dive_tracked"], 0),
        (["overlay", "dive_tracked", "--output", "pictures"], 0),
        (["export", "dive_tracked", "--format", "csv"], 0),
        (["limits"], 0),
        (["limits", "--time", "100000"], 1),
    ],
    ids=str,
)
def test_quiet_leaves_the_exit_code_and_verbose_the_output(
    arguments: list[str], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["replay", "dive", *DIAMETER, "-q"]) == 0
    force = ["--force"] if arguments[0] in {"overlay", "export"} else []
    again = [*arguments[:-1], "again"] if "--output" in arguments else arguments
    assert told(capsys, *arguments, "-q", code=code) == ("", "")
    usual, err = told(capsys, *again, *force, code=code)
    assert usual
    assert err == ""
    more = [*again[:-1], "more"] if "--output" in arguments else arguments
    out, err = told(capsys, *more, *force, "-v", code=code)
    assert out == usual.replace("again", "more")
    assert err.endswith("CPU time of this process\n")
    assert ("# settings in force" in err) == (arguments[0] in {"report", "overlay", "export"})


def test_what_is_asked_for_is_printed_in_any_case(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = told(capsys, "info", "dive", "--json", "-q")
    assert "topics" in json.loads(out)
    out, _ = told(capsys, "evaluate", "--schema", "-q")
    assert "properties" in json.loads(out)
    out, _ = told(capsys, "simulate", "--list", "-q")
    assert "demo" in out
