"""Commands on what a replay has left: evaluate, report, overlay, export."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline_tracker.cli.app import (
    DONE,
    Directory,
    Force,
    Set,
    Task,
    UsageError,
    command,
    number,
)
from pipeline_tracker.cli.talk import Talk, hand_over

_MOST_FRAMES = 100


@command(
    "evaluate demo_tracked --truth bags/demo", "evaluate demo_tracked --truth bags/demo --worst 6"
)
def evaluate(
    directory: Annotated[
        Path | None,
        typer.Argument(metavar="DIR", help="Output of a replay."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="BAG", help="Bag with the truth."),
    ] = None,
    plots: Annotated[bool, typer.Option(help="Draw the errors, coverage and states.")] = True,
    worst: Annotated[
        str | None,
        typer.Option("--worst", metavar="N", help="Draw the N worst frames with their truth."),
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of evaluation.json.")
    ] = False,
) -> Task:
    """Measure a replay against the truth. Gives tables, DIR/evaluation.json and plots."""
    if schema:
        return _print_schema
    if directory is None:
        raise UsageError("no DIR given; name the output directory of a replay")
    if truth is None:
        raise UsageError("no --truth given; name the bag with the truth")
    count = 0 if worst is None else int(number("--worst", worst, int))
    if worst is not None and not 1 <= count <= _MOST_FRAMES:
        raise UsageError(f"--worst {count}: expected 1 to {_MOST_FRAMES}")
    return partial(_evaluate, directory, truth, plots=plots, worst=count)


@command("report demo_tracked", "report demo_tracked --truth bags/demo")
def report(
    directory: Directory,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="BAG", help="Bag with the truth, to show the errors."),
    ] = None,
) -> Task:
    """Write DIR/report.html again. The page needs neither network nor other files."""
    return partial(_report, directory, truth)


@command(
    "overlay demo_tracked --output demo.mp4",
    "overlay demo_tracked --output pictures --every 5 --from 1 --to 4",
)
def overlay(
    directory: Directory,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="FILE.mp4", help="Film to write; or a directory for PNG files."
        ),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option("--bag", metavar="BAG", help="The replayed bag, where it was moved."),
    ] = None,
    every: Annotated[str, typer.Option("--every", metavar="N", help="Show one of N frames.")] = "1",
    from_: Annotated[
        str | None,
        typer.Option("--from", metavar="S", help="Begin so many seconds after the first image."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="S", help="End so many seconds after the first image."),
    ] = None,
    rate: Annotated[
        str, typer.Option("--rate", metavar="R", help="Pictures per second of the film.")
    ] = "10",
    force: Force = False,
) -> Task:
    """Draw what a replay has found on its images. It becomes a film, or PNG files."""
    if output is None:
        raise UsageError("no --output given; name a film (FILE.mp4) or a directory for PNG files")
    numbers = {
        "every": int(number("--every", every, int)),
        "start": None if from_ is None else number("--from", from_, float),
        "end": None if to is None else number("--to", to, float),
        "rate": number("--rate", rate, float),
    }
    return partial(_overlay, directory, output, bag, numbers, force=force)


@command(
    "export demo_tracked --format csv",
    "export demo_tracked --format geojson --set export.origin=[43.1,131.9,0]",
)
def export(
    directory: Directory,
    format_: Annotated[
        str | None,
        typer.Option("--format", metavar="csv|geojson", help="Tables, or a map."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="PATH", help="GeoJSON: file; CSV: directory. By default in DIR."
        ),
    ] = None,
    settings: Set = None,
    force: Force = False,
) -> Task:
    """Write centreline, stretches and events as CSV or GeoJSON."""
    if format_ is None:
        raise UsageError("no --format given; expected csv or geojson")
    return partial(_export, directory, format_, output, list(settings or []), force=force)


def _evaluate(directory: Path, truth: Path, talk: Talk, *, plots: bool, worst: int) -> int:
    from pipeline_tracker.evaluation import evaluate_command

    _tell_settings(directory, talk)
    evaluate_command(directory, truth, talk.console(), plots=plots, worst=worst)
    talk.say(f"Next: the errors in report.html too: pipeline-tracker report {directory}")
    return DONE


def _report(directory: Path, truth: Path | None, talk: Talk) -> int:
    from pipeline_tracker.errors import BagError
    from pipeline_tracker.report.write import write_report

    _tell_settings(directory, talk)
    evaluation = None
    if truth is not None:
        from pipeline_tracker.evaluation import evaluate

        evaluation = evaluate(directory, truth)
    try:
        written = write_report(directory, evaluation)
    except OSError as error:
        raise BagError(f"{directory}: cannot be written ({error.strerror or error})") from None
    talk.say(f"written to {written}")
    return DONE


def _overlay(
    directory: Path,
    output: Path,
    bag: Path | None,
    numbers: dict[str, Any],
    talk: Talk,
    *,
    force: bool,
) -> int:
    from pipeline_tracker.replay.film import Cut, write_film

    _tell_settings(directory, talk)
    cut = Cut(**numbers)
    outcome = write_film(directory, output, cut, bag=bag, force=force, stream=talk.stream)
    talk.say(outcome.in_words())
    return DONE


def _export(
    directory: Path,
    form: str,
    output: Path | None,
    overrides: list[str],
    talk: Talk,
    *,
    force: bool,
) -> int:
    from pipeline_tracker.export import export

    _tell_settings(directory, talk, overrides)
    talk.say(export(directory, form, output, overrides, force=force).in_words())
    return DONE


def _print_schema(_talk: Talk) -> int:
    import json

    from pipeline_tracker.evaluation import evaluation_schema

    hand_over(json.dumps(evaluation_schema(), indent=2))
    return DONE


def _tell_settings(directory: Path, talk: Talk, overrides: Sequence[str] = ()) -> None:
    """Say by which settings a replay was made; where there is none, the command will say so."""
    file = directory / "settings.yaml"
    if talk.verbose and file.exists():
        from pipeline_tracker.settings_io import load_settings

        talk.settings(load_settings(file, list(overrides)))
