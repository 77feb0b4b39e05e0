"""Commands that need ROS: run, play."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline_tracker.cli.app import (
    Bag,
    Config,
    RosArgs,
    Set,
    Task,
    UsageError,
    command,
    number,
)
from pipeline_tracker.cli.talk import Talk


@command(
    "run --set pipe.diameter=0.6",
    "run --config site.yaml --record dive_1 -v",
    "run --config site.yaml --ros-args -r __ns:=/auv -r vnm/pose:=/nav/pose",
)
def run(
    config: Config = None,
    settings: Set = None,
    separate: Annotated[
        bool, typer.Option("--separate", help="One process for each node.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="DIR", help="Record the results to a bag."),
    ] = None,
    record_images: Annotated[
        bool, typer.Option("--record-images", help="Record the images too.")
    ] = False,
    ros_args: RosArgs = None,
) -> Task:
    """Run the live nodes until Ctrl-C. All are in one process, or each has its own."""
    if record_images and record is None:
        raise UsageError("--record-images: expected --record DIR with it, the bag to write")
    given = None if record is None else (record, record_images)
    return partial(_run, config, list(settings or []), separate, _of_ros(ros_args), given)


@command("play bags/demo", "play dive.mcap --rate 0.5 --loop --ros-args -r __ns:=/auv")
def play(
    bag: Bag,
    rate: Annotated[
        str, typer.Option("--rate", metavar="R", help="How many times as fast as recorded.")
    ] = "1.0",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    ros_args: RosArgs = None,
) -> Task:
    """Publish a recorded bag on the live topics, with /clock."""
    return partial(_play, bag, number("--rate", rate, float), loop, _of_ros(ros_args))


def _of_ros(arguments: Sequence[str] | None) -> list[str]:
    given = list(arguments or [])
    if given and given[0] != "--ros-args":
        raise UsageError(f"{given[0]} is not understood; ROS's own arguments follow --ros-args")
    return given[1:]


def _run(
    config: Path | None,
    overrides: list[str],
    separate: bool,
    ros_args: list[str],
    record: tuple[Path, bool] | None,
    talk: Talk,
) -> int:
    from pipeline_tracker.nodes.launcher import Recording, run
    from pipeline_tracker.nodes.process import Log

    recording = None if record is None else Recording(*record)
    log = Log.ERRORS if talk.quiet else Log.DEBUG if talk.verbose else Log.USUAL
    return run(config, overrides, separate, ros_args, recording, log, talk.settings)


def _play(bag: Path, rate: float, loop: bool, ros_args: list[str], talk: Talk) -> int:
    from pipeline_tracker.nodes.player import play

    return play(bag, rate, loop, ros_args, quiet=talk.quiet)
