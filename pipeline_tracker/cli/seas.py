"""Commands that make seas: simulate, benchmark."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from pipeline_tracker.cli.app import (
    DONE,
    INTERRUPTED,
    SOME_FAILED,
    Task,
    UsageError,
    command,
    number,
    refuse,
)
from pipeline_tracker.cli.talk import Talk, hand_over

_MOST_JOBS = 256


@command(
    "simulate --list",
    "simulate shadow --output my_sea --set frames=3 --seed 7",
)
def simulate(
    scenario: Annotated[
        str | None,
        typer.Argument(metavar="SCENARIO", help="Name of a scenario, or a YAML file."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="BAG", help="Directory of the bag to write."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A value of the scenario, such as frames=6."
        ),
    ] = None,
    seed: Annotated[
        str | None,
        typer.Option("--seed", metavar="N", help="Another sea of the same kind."),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the scenarios.")] = False,
) -> Task:
    """Render a sea: a bag with images, calibration, poses and truth."""
    if list_:
        return _list_scenarios
    if scenario is None:
        raise UsageError("no SCENARIO given; `pipeline-tracker simulate --list` lists them")
    if output is None:
        raise UsageError("no --output given; name the directory of the bag to write")
    which = None if seed is None else int(number("--seed", seed, int))
    return partial(_simulate, scenario, output, list(settings or []), which)


@command(
    "benchmark seeds --output seeds --jobs 2",
    "benchmark my_dives.yaml --scheduler tcp://10.0.0.5:8786",
)
def benchmark(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="YAML file: scenarios x seeds x settings.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Directory to write; by default NAME_benchmark here."
        ),
    ] = None,
    jobs: Annotated[
        str | None,
        typer.Option("--jobs", metavar="N", help="Number of processes on this machine; 1."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work."
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replay and measure again what is done; keep seas.")
    ] = False,
) -> Task:
    """Simulate, replay and evaluate what a manifest names. What is done is not done again."""
    if jobs is not None and scheduler is not None:
        raise UsageError("--jobs and --scheduler: expected one of them; the cluster has workers")
    processes = 1 if jobs is None else int(number("--jobs", jobs, int))
    if not 1 <= processes <= _MOST_JOBS:
        raise UsageError(f"--jobs {processes}: expected 1 to {_MOST_JOBS}")
    target = output or Path(f"{manifest.stem}_benchmark")
    return partial(_benchmark, manifest, target, processes, scheduler, force=force)


def _list_scenarios(_talk: Talk) -> int:
    from pipeline_tracker.simulation import list_scenarios

    scenarios = list_scenarios()
    width = max(map(len, scenarios), default=0)
    hand_over("\n".join(f"{name:<{width}}  {text}" for name, text in scenarios.items()))
    return DONE


def _simulate(
    scenario: str, output: Path, overrides: list[str], seed: int | None, talk: Talk
) -> int:
    from pipeline_tracker.simulation import simulate

    if talk.verbose:
        from pipeline_tracker.simulation.scenario_files import dump_scenario, load_scenario

        talk.detail(dump_scenario(load_scenario(scenario, overrides, seed)).rstrip("\n"))
    written = simulate(scenario, output, overrides, seed, progress=not talk.quiet)
    talk.say(f"written to {written}")
    return DONE


def _benchmark(
    manifest: Path, output: Path, jobs: int, scheduler: str | None, talk: Talk, *, force: bool
) -> int:
    from pipeline_tracker.benchmark import benchmark_command

    outcome = benchmark_command(
        manifest,
        output,
        jobs=jobs,
        scheduler=scheduler,
        force=force,
        console=talk.console(),
        progress=talk.console(stderr=True),
    )
    if outcome.interrupted:
        return refuse(
            f"interrupted; what is done is in {output}, the same command goes on with it",
            INTERRUPTED,
        )
    return DONE if outcome.whole else SOME_FAILED
