"""What runs a command line, and turns whatever comes of it into an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any

import typer

from pipeline_tracker import __version__
from pipeline_tracker.cli import (  # noqa: F401 - they add their commands to the application
    dives,
    live,
    planning,
    results,
    seas,
)
from pipeline_tracker.cli.app import DONE, INTERRUPTED, UsageError, app, refuse
from pipeline_tracker.cli.talk import hand_over
from pipeline_tracker.errors import PipelineTrackerError


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> Callable[[], int] | None:
    if version:
        return partial(_say, f"pipeline-tracker {__version__}")
    if context.invoked_subcommand is None:
        raise UsageError("no command given; see `pipeline-tracker --help`")
    return None


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    # Else Numba, where colorama is installed, ends what is said on a terminal with a colour code.
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    sys.exit(run_command(sys.argv[1:] if arguments is None else arguments))


def run_command(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: without the program's name.
    """
    try:
        command = typer.main.get_command(app)
        task = command.main(
            _guard_ros_args(arguments), prog_name="pipeline-tracker", standalone_mode=False
        )
        return _done(task)
    except (PipelineTrackerError, UsageError) as error:
        return refuse(str(error))
    except KeyboardInterrupt:
        return refuse("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output is gone; nothing is to be said to them.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        # typer's errors come from click, or in newer versions from a copy of it inside typer.
        if type(error).__name__ == "Abort":
            return refuse("interrupted", INTERRUPTED)
        if not hasattr(error, "format_message"):
            raise
        return refuse(f"{_usage_error(error)}; see `pipeline-tracker {_help_of(error)}`")


def _done(task: Any) -> int:
    # A help page leaves an exit code, a command its task.
    code = task() if callable(task) else int(task or DONE)
    sys.stdout.flush()
    return code


def _usage_error(error: Any) -> str:
    text = " ".join(str(error.format_message()).split()).rstrip(".")
    return text[:1].lower() + text[1:]


def _help_of(error: Any) -> str:
    context = getattr(error, "ctx", None)
    command = getattr(context, "info_name", None) if getattr(context, "parent", None) else None
    return f"{command} --help" if command else "--help"


def _guard_ros_args(arguments: Sequence[str]) -> list[str]:
    """Keep ROS's arguments away from our own parser: they follow ``--ros-args``."""
    arguments = list(arguments)
    if "--ros-args" in arguments:
        place = arguments.index("--ros-args")
        if "--" not in arguments[:place]:
            arguments.insert(place, "--")
    return arguments


def _say(text: str) -> int:
    hand_over(text)
    return DONE
