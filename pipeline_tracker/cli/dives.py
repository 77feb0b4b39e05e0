"""Commands on a recorded dive: replay, info, salvage."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline_tracker.cli.app import (
    DONE,
    INTERRUPTED,
    NEVER_FOUND,
    Bag,
    Config,
    Set,
    Task,
    UsageError,
    command,
    refuse,
)
from pipeline_tracker.cli.talk import Talk, hand_over


@command(
    "replay bags/demo --set pipe.diameter=0.6",
    "replay dive.mcap --config site.yaml --output dive_1 -v",
    "replay dive.mcap --output dive_1 --resume",
)
def replay(  # noqa: PLR0913, PLR0917 - its options are read from here
    bag: Bag,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Directory to write; by default NAME_tracked here."
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier replay in DIR.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a replay that was broken off in DIR.")
    ] = False,
    config: Config = None,
    settings: Set = None,
    mono: Annotated[bool, typer.Option("--mono", help="Use the left camera alone.")] = False,
    recognition_only: Annotated[
        bool, typer.Option("--recognition-only", help="Each frame by itself, no tracking.")
    ] = False,
    technique: Annotated[
        str | None,
        typer.Option("--technique", metavar="1|2|3|4", help="Technique of recognition."),
    ] = None,
) -> Task:
    """Run a recorded bag through the whole pipeline. It goes at CPU speed and drops no frame."""
    if force and resume:
        raise UsageError("--force and --resume: expected one of them")
    overrides = list(settings or [])
    if mono:
        overrides.append("mode=mono")
    if recognition_only:
        overrides.append("recognition.only=true")
    if technique is not None:
        if technique not in ("1", "2", "3", "4"):
            raise UsageError(f"--technique {technique}: expected 1, 2, 3 or 4")
        overrides.append(f"recognition.technique={technique}")
    return partial(_replay, bag, output, config, overrides, force=force, resume=resume)


@command("info bags/demo", "info dive.mcap --config site.yaml --json")
def info(
    bag: Bag,
    config: Config = None,
    settings: Set = None,
    json_: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> Task:
    """Tell what is in a bag, and what a replay would use and miss."""
    return partial(_info, bag, config, list(settings or []), as_json=json_)


@command("salvage broken.mcap --output whole")
def salvage(
    bag: Bag,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Directory of the bag to write."),
    ] = None,
) -> Task:
    """Write every readable message of a damaged bag to a sound one."""
    if output is None:
        raise UsageError("no --output given; name the directory of the bag to write")
    return partial(_salvage, bag, output)


def _replay(
    bag: Path,
    output: Path | None,
    config: Path | None,
    overrides: list[str],
    talk: Talk,
    *,
    force: bool,
    resume: bool,
) -> int:
    from pipeline_tracker.settings_io import load_settings

    base = None
    if resume:
        from pipeline_tracker.replay import default_output, earlier_settings

        base = earlier_settings(output or default_output(bag))
    settings = load_settings(config, overrides, base)
    talk.settings(settings)
    from pipeline_tracker.replay import default_output, replay

    output = output or default_output(bag)
    outcome = replay(bag, settings, output, force=force, resume=resume, stream=talk.stream)
    talk.detail(outcome.summary.times_in_words())
    talk.say(outcome.text)
    if outcome.summary.interrupted:
        return refuse(
            f"interrupted; what was computed is in {outcome.output}, --resume goes on with it",
            INTERRUPTED,
        )
    return DONE if outcome.summary.found else NEVER_FOUND


def _info(
    bag: Path, config: Path | None, overrides: list[str], talk: Talk, *, as_json: bool
) -> int:
    import json

    from pipeline_tracker.errors import SettingsError
    from pipeline_tracker.replay.bag_info import bag_info
    from pipeline_tracker.settings_io import load_settings

    has_diameter = True
    try:
        settings = load_settings(config, overrides)
    except SettingsError:
        # A bag can be looked into without it; a replay could not do.
        has_diameter = False
        settings = load_settings(config, overrides, {"pipe.diameter": 1.0})
    if has_diameter:
        talk.settings(settings)
    found = bag_info(bag, settings, has_diameter=has_diameter)
    if as_json:
        hand_over(json.dumps(found.as_json(), indent=2))
    else:
        talk.say(found.in_words())
    return DONE


def _salvage(bag: Path, output: Path, talk: Talk) -> int:
    from pipeline_tracker.bags.salvage import salvage

    talk.say(salvage(bag, output).in_words())
    return DONE
