"""The help pages: examples that are true, quick, and plain where they should be."""

from __future__ import annotations

import os
import pty
import re
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from pipeline_tracker import cli

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = sorted(command.callback.__name__ for command in cli.app.registered_commands)
COLOUR = re.compile(r"\x1b\[[0-9;]*3[0-7]m")
# CPU time, s: what else runs on the machine does not count.
HELP_WITHIN = 0.5


def process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pipeline_tracker.cli", *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def on_a_terminal(*arguments: str, **environment: str) -> str:
    """Return what a command writes to a terminal."""
    ours, its = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "pipeline_tracker.cli", *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color"} | environment,
        stdin=its,
        stdout=its,
        stderr=its,
    )
    os.close(its)
    written = b""
    # The end of a terminal without writers is an error on Linux.
    try:
        while part := os.read(ours, 65536):
            written += part
    except OSError:
        pass
    os.close(ours)
    assert child.wait() == 0
    return written.decode()


def examples_of(command: str, capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    assert cli.run_command([command, "--help"]) == 0
    shown = capsys.readouterr().out.split("\nExamples:\n")[1]
    return [shlex.split(line) for line in shown.splitlines()]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_examples_are_understood(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Parsed as the command line does, and not run."""
    examples = examples_of(command, capsys)
    assert 1 <= len(examples) <= 3
    for program, name, *words in examples:
        assert (program, name) == ("pipeline-tracker", command)
        task = typer.main.get_command(cli.app).main(
            cli._guard_ros_args([name, *words]), prog_name=program, standalone_mode=False
        )
        assert callable(task)


def test_a_wrong_example_would_be_noticed() -> None:
    with pytest.raises(Exception, match="No such option"):
        typer.main.get_command(cli.app).main(["replay", "a", "--sett"], standalone_mode=False)


def test_names_in_the_examples_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    from pipeline_tracker.benchmark.manifest import find_manifest
    from pipeline_tracker.simulation import list_scenarios

    assert any("bags/demo" in words for words in examples_of("replay", capsys))
    assert (ROOT / "bags" / "demo").is_dir()
    (scenario,) = (words[2] for words in examples_of("simulate", capsys) if words[2][0] != "-")
    assert scenario in list_scenarios()
    assert find_manifest(Path(examples_of("benchmark", capsys)[0][2])).is_file()


@pytest.mark.parametrize("arguments", [["--help"], ["replay", "--help"]])
@pytest.mark.parametrize("terminal", [False, True])
def test_help_is_quick(arguments: list[str], terminal: bool) -> None:
    def used() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    def once() -> float:
        before = used()
        if terminal:
            on_a_terminal(*arguments)
        else:
            process(*arguments)
        return used() - before

    assert min(once() for _ in range(3)) < HELP_WITHIN


def test_no_line_of_the_list_is_cut_off() -> None:
    shown = process("--help", COLUMNS="80").stdout.split("Commands:\n")[1]
    assert len(shown.splitlines()) == len(COMMANDS)
    assert "..." not in shown


def test_colours_are_for_terminals_alone() -> None:
    for arguments in (["--help"], ["limits"]):
        assert "\x1b" not in process(*arguments, TERM="xterm-256color", FORCE_COLOR="").stdout
    assert COLOUR.search(on_a_terminal("replay", "--help"))


def test_no_colour_where_it_is_not_wanted() -> None:
    for arguments in (["replay", "--help"], ["doctor", "--no-talk"]):
        assert not COLOUR.search(on_a_terminal(*arguments, NO_COLOR="1"))


def test_a_quiet_command_writes_nothing_at_all_on_a_terminal(tmp_path: Path) -> None:
    pytest.importorskip("trimesh", reason="the extra [sim] is not installed")
    small = ("frames=1", "camera.width=240", "camera.height=160")
    values = [word for value in small for word in ("--set", value)]
    sea = str(tmp_path / "sea")
    assert on_a_terminal("simulate", "clear", "-q", *values, "--output", sea) == ""


def test_the_shell_completes() -> None:
    def completed(words: str) -> list[str]:
        return process(
            _PIPELINE_TRACKER_COMPLETE="complete_bash",
            COMP_WORDS=f"pipeline-tracker {words}",
            COMP_CWORD=str(len(words.split())),
        ).stdout.split()

    assert completed("sal") == ["salvage"]
    assert completed("replay --rec") == ["--recognition-only"]
    page = process("--help").stdout
    assert "--install-completion" in page
    assert "--show-completion" in page
