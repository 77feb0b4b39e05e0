"""Commands on speed and on this machine: limits, bench, doctor."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline_tracker.cli.app import (
    DONE,
    SOMETHING_WRONG,
    TOO_SLOW,
    Set,
    Task,
    UsageError,
    command,
    number,
)
from pipeline_tracker.cli.talk import Talk


@command(
    "limits --altitude 2 --speed 1.5",
    "limits --altitude 4 --tilt 30 --time 120 --plot limits.png",
)
def limits(
    altitude: Annotated[
        str, typer.Option("--altitude", metavar="M", help="Height of the camera above the pipe.")
    ] = "2",
    angle: Annotated[
        str, typer.Option("--angle", metavar="DEG", help="Angle of view along the pipe.")
    ] = "60",
    tilt: Annotated[
        str, typer.Option("--tilt", metavar="DEG", help="Tilt of the camera from straight down.")
    ] = "0",
    overlap: Annotated[
        str, typer.Option("--overlap", metavar="P", help="Share of an image seen again.")
    ] = "0.7",
    speed: Annotated[str, typer.Option("--speed", metavar="M/S", help="Of the vehicle.")] = "1",
    time: Annotated[
        str | None,
        typer.Option("--time", metavar="MS", help="What a frame takes; exit 1 if it is too long."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="FILE", help="Draw it over height and speed: PNG, SVG, PDF."
        ),
    ] = None,
) -> Task:
    """Tell how fast it must be for a planned dive. This is the condition t1 <= t2 of 5.3.1."""
    given = {"altitude": altitude, "angle": angle, "tilt": tilt, "overlap": overlap, "speed": speed}
    numbers = {name: number(f"--{name}", text, float) for name, text in given.items()}
    spent = None if time is None else number("--time", time, float) / 1e3
    if spent is not None and not 0.0 < spent < 1e6:
        raise UsageError(f"--time {time}: expected milliseconds above 0")
    return partial(_limits, numbers, spent, plot)


@command(
    "bench --sizes 600x400 --repeat 3", "bench --images dive.mcap --set pipe.diameter=0.6 --live"
)
def bench(
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the figures as JSON."),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Measure live nodes over DDS too.")] = False,
    images: Annotated[
        Path | None,
        typer.Option("--images", metavar="BAG", help="Bag to measure with; by default the demo."),
    ] = None,
    settings: Set = None,
    sizes: Annotated[
        str | None,
        typer.Option("--sizes", metavar="WxH,...", help="Sizes to resize the images to."),
    ] = None,
    repeat: Annotated[
        str | None,
        typer.Option("--repeat", metavar="N", help="Rounds; 30, 10 above 2 million pixels."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="N", help="Watch the memory over N tracked pairs."),
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option("--plots", metavar="DIR", help="Measure growth; draw it and a flame graph."),
    ] = None,
) -> Task:
    """Measure speed side by side with stock methods. Every step is measured, on one core."""
    rounds = None if repeat is None else int(number("--repeat", repeat, int))
    pairs = None if frames is None else int(number("--frames", frames, int))
    given = {"repeat": rounds, "frames": pairs, "live": live, "images": images, "plots": plots}
    return partial(_bench, json_file, sizes, tuple(settings or ()), given)


@command("doctor", "doctor --no-talk --json")
def doctor(
    json_: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
    talk: Annotated[
        bool, typer.Option(help="Let two processes talk over DDS, for some seconds.")
    ] = True,
) -> Task:
    """Tell what is wrong with this machine, and what to do about it."""
    return partial(_doctor, as_json=json_, converse=talk)


def _limits(numbers: dict[str, float], spent: float | None, plot: Path | None, talk: Talk) -> int:
    from pipeline_tracker.limits import Plan

    plan = Plan(**numbers)
    plan.check()
    talk.say(plan.in_words(spent))
    if plot is not None:
        from pipeline_tracker.report.limits_plot import write_limits_plot

        write_limits_plot(plan, plot, spent)
        talk.say(f"drawn in {plot}")
    return TOO_SLOW if spent is not None and spent > plan.time else DONE


def _bench(
    json_file: Path | None,
    sizes: str | None,
    overrides: tuple[str, ...],
    given: dict[str, Any],
    talk: Talk,
) -> int:
    from pipeline_tracker.bench import BenchOptions, bench_command
    from pipeline_tracker.bench.options import SIZES, parse_sizes
    from pipeline_tracker.bench.tables import WIDTH

    chosen = SIZES if sizes is None else parse_sizes(sizes)
    bench_command(
        BenchOptions(settings=overrides, sizes=chosen, **given),
        json_file,
        console=talk.console(width=WIDTH, highlight=False),
        progress=talk.console(stderr=True),
    )
    return DONE


def _doctor(talk: Talk, *, as_json: bool, converse: bool) -> int:
    from pipeline_tracker.doctor import doctor_command

    console = talk.console(highlight=False, soft_wrap=True)
    sound = doctor_command(console, as_json=as_json, talk=converse)
    return DONE if sound else SOMETHING_WRONG
