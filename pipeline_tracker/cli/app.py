"""What all commands have in common: the application, its options, exit codes and refusals."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from pipeline_tracker.cli.talk import Talk

DONE, NEVER_FOUND, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SOME_FAILED = 1
TOO_SLOW = 1
SOMETHING_WRONG = 1

# What is to be done, in the end; it returns an exit code.
Task = Callable[[Talk], int]

Bag = Annotated[Path, typer.Argument(metavar="BAG", help="Directory or .mcap file of a bag.")]
Directory = Annotated[Path, typer.Argument(metavar="DIR", help="Output of a replay.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="YAML file of settings."),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="A setting, such as pipe.diameter=0.6; repeatable."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace what is there.")]
RosArgs = Annotated[
    list[str] | None,
    typer.Argument(metavar="[--ros-args ...]", help="ROS's own arguments: remappings, namespace."),
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="No progress and no summary: errors alone.")
]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", help="Tell settings in force and times, on standard error."),
]


class UsageError(Exception):
    """The command line lacks something."""


app = typer.Typer(
    name="pipeline-tracker",
    help="Follow an underwater pipeline with cameras alone.",
    # Frames and colours are for people; without them it is quicker too.
    rich_markup_mode="rich" if sys.stdout.isatty() else None,
    pretty_exceptions_enable=False,
    add_completion=True,
)


def command(*examples: str) -> Callable[[Callable[..., Task]], Callable[..., Callable[[], int]]]:
    """Make a command of a function that reads its arguments and returns what is to be done.

    It has -q and -v besides, and its help ends with examples.

    Args:
        examples: command lines, without the program's name.
    """

    class Command(TyperCommand):
        def format_help(self, ctx: Any, formatter: Any) -> None:
            """Write the help, and below it the examples as they are to be typed."""
            super().format_help(ctx, formatter)
            lines = [f"  pipeline-tracker {example}" for example in examples]
            formatter.write("\n".join(["\nExamples:", *lines, ""]))

    def register(function: Callable[..., Task]) -> Callable[..., Callable[[], int]]:
        talking = _talking(function)
        app.command(cls=Command)(talking)
        return talking

    return register


def _talking(function: Callable[..., Task]) -> Callable[..., Callable[[], int]]:
    """Return a function with the options -q and -v, by which its task talks."""

    @wraps(function)
    def talking(*, quiet: bool, verbose: bool, **arguments: Any) -> Callable[[], int]:
        if quiet and verbose:
            raise UsageError("--quiet and --verbose: expected one of them")
        task = function(**arguments)
        return partial(_carry_out, task, Talk(quiet=quiet, verbose=verbose))

    # typer reads the options from the signature, and their types from the annotations.
    own = inspect.signature(function, eval_str=True)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("quiet", Quiet), ("verbose", Verbose))
    ]
    whole = own.replace(parameters=[*own.parameters.values(), *added])
    talking.__signature__ = whole  # type: ignore[attr-defined]
    talking.__annotations__ = {n: p.annotation for n, p in whole.parameters.items()}
    return talking


def _carry_out(task: Task, talk: Talk) -> int:
    with talk.timed():
        return task(talk)


def number(option: str, text: str, kind: type[float]) -> float:
    """Return an option's number.

    Raises:
        UsageError: it is none.
    """
    try:
        return kind(text)
    except ValueError:
        expected = "an integer" if kind is int else "a number"
        raise UsageError(f"{option} {text}: expected {expected}") from None


def refuse(reason: str, code: int = BAD_INPUT) -> int:
    """Say in one line on standard error why it is not done; return the exit code."""
    sys.stderr.write(f"pipeline-tracker: {' '.join(reason.split())}\n")
    return code
