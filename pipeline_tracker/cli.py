"""The command line: pipeline-tracker COMMAND ...

Each command reads its arguments and hands back what is to be done; ``main`` does it and turns the
outcome into an exit code: 0 done; 1 done, but the pipe was never found (or a run of a benchmark
failed); 2 wrong command or bad input, with one line on stderr; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from pipeline_tracker import __version__
from pipeline_tracker.errors import PipelineTrackerError

DONE, NEVER_FOUND, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SOME_FAILED = 1
TOO_SLOW = 1
SOMETHING_WRONG = 1
_MOST_JOBS = 256
_MOST_FRAMES = 100

Task = Callable[[], int]

app = typer.Typer(
    name="pipeline-tracker",
    help="Follow an underwater pipeline with cameras alone.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=True,
)

_Bag = Annotated[Path, typer.Argument(metavar="BAG", help="Directory or .mcap file of a bag.")]
_Config = Annotated[
    Optional[Path],  # noqa: UP045 - typer reads it on Python 3.10 too
    typer.Option("--config", metavar="FILE", help="YAML file of settings."),
]
_Set = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--set", metavar="KEY=VALUE", help="A setting, such as pipe.diameter=0.6; repeatable."
    ),
]


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> Task | None:
    if version:
        return partial(_say, f"pipeline-tracker {__version__}")
    if context.invoked_subcommand is None:
        raise _UsageError("no command given; see `pipeline-tracker --help`")
    return None


@app.command()
def replay(  # noqa: PLR0913, PLR0917 - its options are read from here
    bag: _Bag,
    output: Annotated[
        Optional[Path],  # noqa: UP045
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
    config: _Config = None,
    settings: _Set = None,
    mono: Annotated[bool, typer.Option("--mono", help="Use the left camera alone.")] = False,
    recognition_only: Annotated[
        bool, typer.Option("--recognition-only", help="Each frame by itself, no tracking.")
    ] = False,
    technique: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--technique", metavar="1|2|3|4", help="Technique of recognition."),
    ] = None,
) -> Task:
    """Run a recorded bag through the whole pipeline, as fast as it goes, dropping no frame."""
    if force and resume:
        raise _UsageError("--force and --resume: expected one of them")
    overrides = list(settings or [])
    if mono:
        overrides.append("mode=mono")
    if recognition_only:
        overrides.append("recognition.only=true")
    if technique is not None:
        if technique not in ("1", "2", "3", "4"):
            raise _UsageError(f"--technique {technique}: expected 1, 2, 3 or 4")
        overrides.append(f"recognition.technique={technique}")
    return partial(_replay, bag, output, config, overrides, force=force, resume=resume)


@app.command(context_settings={"ignore_unknown_options": False})
def run(
    config: _Config = None,
    settings: _Set = None,
    separate: Annotated[
        bool, typer.Option("--separate", help="One process for each node.")
    ] = False,
    record: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--record", metavar="DIR", help="Record the results to a bag."),
    ] = None,
    record_images: Annotated[
        bool, typer.Option("--record-images", help="Record the images too.")
    ] = False,
    ros_args: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Argument(
            metavar="[--ros-args ...]", help="ROS's own arguments: remappings, namespace."
        ),
    ] = None,
) -> Task:
    """Run the live nodes until Ctrl-C: all in one process, or one process each."""
    if record_images and record is None:
        raise _UsageError("--record-images: expected --record DIR with it, the bag to write")
    given = None if record is None else (record, record_images)
    return partial(_run, config, list(settings or []), separate, _of_ros(ros_args), given)


@app.command()
def play(
    bag: _Bag,
    rate: Annotated[
        str, typer.Option("--rate", metavar="R", help="How many times as fast as recorded.")
    ] = "1.0",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    ros_args: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Argument(
            metavar="[--ros-args ...]", help="ROS's own arguments: remappings, namespace."
        ),
    ] = None,
) -> Task:
    """Publish a recorded bag on the live topics, with /clock."""
    return partial(_play, bag, _number("--rate", rate, float), loop, _of_ros(ros_args))


@app.command()
def info(
    bag: _Bag,
    config: _Config = None,
    settings: _Set = None,
    json_: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> Task:
    """Tell what is in a bag, what a replay would use of it and what is missing."""
    return partial(_info, bag, config, list(settings or []), as_json=json_)


@app.command()
def salvage(
    bag: _Bag,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--output", metavar="DIR", help="Directory of the bag to write."),
    ] = None,
) -> Task:
    """Write every readable message of a damaged bag to a sound one."""
    if output is None:
        raise _UsageError("no --output given; name the directory of the bag to write")
    return partial(_salvage, bag, output)


@app.command()
def simulate(
    scenario: Annotated[
        Optional[str],  # noqa: UP045
        typer.Argument(metavar="SCENARIO", help="Name of a scenario, or a YAML file."),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--output", metavar="BAG", help="Directory of the bag to write."),
    ] = None,
    settings: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A value of the scenario, such as frames=6."
        ),
    ] = None,
    seed: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--seed", metavar="N", help="Another sea of the same kind."),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the scenarios.")] = False,
) -> Task:
    """Render a sea: a bag with images, calibration, poses and truth."""
    if list_:
        return _list_scenarios
    if scenario is None:
        raise _UsageError("no SCENARIO given; `pipeline-tracker simulate --list` lists them")
    if output is None:
        raise _UsageError("no --output given; name the directory of the bag to write")
    number = None if seed is None else int(_number("--seed", seed, int))
    return partial(_simulate, scenario, output, list(settings or []), number)


@app.command()
def evaluate(
    directory: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Argument(metavar="DIR", help="Output of a replay."),
    ] = None,
    truth: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--truth", metavar="BAG", help="Bag with the truth."),
    ] = None,
    plots: Annotated[bool, typer.Option(help="Draw the errors, coverage and states.")] = True,
    worst: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--worst", metavar="N", help="Draw the N worst frames with their truth."),
    ] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON Schema of evaluation.json.")
    ] = False,
) -> Task:
    """Measure a replay against the truth: the paper's tables, DIR/evaluation.json and plots."""
    if schema:
        return _print_schema
    if directory is None:
        raise _UsageError("no DIR given; name the output directory of a replay")
    if truth is None:
        raise _UsageError("no --truth given; name the bag with the truth")
    count = 0 if worst is None else int(_number("--worst", worst, int))
    if worst is not None and not 1 <= count <= _MOST_FRAMES:
        raise _UsageError(f"--worst {count}: expected 1 to {_MOST_FRAMES}")
    return partial(_evaluate, directory, truth, plots=plots, worst=count)


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Output of a replay.")],
    truth: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--truth", metavar="BAG", help="Bag with the truth, to show the errors."),
    ] = None,
) -> Task:
    """Write DIR/report.html again: one page that needs neither network nor other files."""
    return partial(_report, directory, truth)


@app.command()
def overlay(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Output of a replay.")],
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--output", metavar="FILE.mp4", help="Film to write; or a directory for PNG files."
        ),
    ] = None,
    bag: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--bag", metavar="BAG", help="The replayed bag, where it was moved."),
    ] = None,
    every: Annotated[str, typer.Option("--every", metavar="N", help="Show one of N frames.")] = "1",
    from_: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--from", metavar="S", help="Begin so many seconds after the first image."),
    ] = None,
    to: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--to", metavar="S", help="End so many seconds after the first image."),
    ] = None,
    rate: Annotated[
        str, typer.Option("--rate", metavar="R", help="Pictures per second of the film.")
    ] = "10",
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> Task:
    """Draw what a replay has found on its images: a film, or PNG files."""
    if output is None:
        raise _UsageError("no --output given; name a film (FILE.mp4) or a directory for PNG files")
    numbers = {
        "every": int(_number("--every", every, int)),
        "start": None if from_ is None else _number("--from", from_, float),
        "end": None if to is None else _number("--to", to, float),
        "rate": _number("--rate", rate, float),
    }
    return partial(_overlay, directory, output, bag, numbers, force=force)


@app.command()
def export(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Output of a replay.")],
    format_: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--format", metavar="csv|geojson", help="Tables, or a map."),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--output", metavar="PATH", help="GeoJSON: file; CSV: directory. By default in DIR."
        ),
    ] = None,
    settings: _Set = None,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> Task:
    """Write centreline, stretches and events for other programs: CSV, or GeoJSON for maps."""
    if format_ is None:
        raise _UsageError("no --format given; expected csv or geojson")
    return partial(_export, directory, format_, output, list(settings or []), force=force)


@app.command()
def benchmark(
    manifest: Annotated[
        Path, typer.Argument(metavar="MANIFEST", help="YAML file: scenarios x seeds x settings.")
    ],
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--output", metavar="DIR", help="Directory to write; by default NAME_benchmark here."
        ),
    ] = None,
    jobs: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--jobs", metavar="N", help="Number of processes on this machine; 1."),
    ] = None,
    scheduler: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work."
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replay and measure again what is done; keep seas.")
    ] = False,
) -> Task:
    """Simulate, replay and evaluate all that a manifest names; what is done is not done again."""
    if jobs is not None and scheduler is not None:
        raise _UsageError("--jobs and --scheduler: expected one of them; the cluster has workers")
    number = 1 if jobs is None else int(_number("--jobs", jobs, int))
    if not 1 <= number <= _MOST_JOBS:
        raise _UsageError(f"--jobs {number}: expected 1 to {_MOST_JOBS}")
    target = output or Path(f"{manifest.stem}_benchmark")
    return partial(_benchmark, manifest, target, number, scheduler, force=force)


@app.command()
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
        Optional[str],  # noqa: UP045
        typer.Option("--time", metavar="MS", help="What a frame takes; exit 1 if it is too long."),
    ] = None,
    plot: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(
            "--plot", metavar="FILE", help="Draw it over height and speed: PNG, SVG, PDF."
        ),
    ] = None,
) -> Task:
    """Tell how fast it must be for a planned dive: the condition t1 <= t2 of 5.3.1."""
    given = {"altitude": altitude, "angle": angle, "tilt": tilt, "overlap": overlap, "speed": speed}
    numbers = {name: _number(f"--{name}", text, float) for name, text in given.items()}
    spent = None if time is None else _number("--time", time, float) / 1e3
    if spent is not None and not 0.0 < spent < 1e6:
        raise _UsageError(f"--time {time}: expected milliseconds above 0")
    return partial(_limits, numbers, spent, plot)


@app.command()
def bench(
    json_file: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--json", metavar="FILE", help="Write the figures as JSON."),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Measure live nodes over DDS too.")] = False,
    images: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--images", metavar="BAG", help="Bag to measure with; by default the demo."),
    ] = None,
    settings: _Set = None,
    sizes: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--sizes", metavar="WxH,...", help="Sizes to resize the images to."),
    ] = None,
    repeat: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--repeat", metavar="N", help="Rounds; 30, 10 above 2 million pixels."),
    ] = None,
    frames: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--frames", metavar="N", help="Watch the memory over N tracked pairs."),
    ] = None,
    plots: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--plots", metavar="DIR", help="Measure growth; draw it and a flame graph."),
    ] = None,
) -> Task:
    """Measure speed: every step side by side with stock methods, on one core."""
    rounds = None if repeat is None else int(_number("--repeat", repeat, int))
    pairs = None if frames is None else int(_number("--frames", frames, int))
    given = {"repeat": rounds, "frames": pairs, "live": live, "images": images, "plots": plots}
    return partial(_bench, json_file, sizes, tuple(settings or ()), given)


@app.command()
def doctor(
    json_: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
    talk: Annotated[
        bool, typer.Option(help="Let two processes talk over DDS, for some seconds.")
    ] = True,
) -> Task:
    """Tell what is wrong with this machine for pipeline_tracker, and what to do about it."""
    return partial(_doctor, as_json=json_, talk=talk)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
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
    except (PipelineTrackerError, _UsageError) as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        return _refuse("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output is gone; nothing is to be said to them.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        # typer's errors come from click, or in newer versions from a copy of it inside typer.
        if type(error).__name__ == "Abort":
            return _refuse("interrupted", INTERRUPTED)
        if not hasattr(error, "format_message"):
            raise
        return _refuse(f"{_usage_error(error)}; see `pipeline-tracker {_help_of(error)}`")


def _done(task: Any) -> int:
    # A help page leaves an exit code, a command its task.
    code = task() if callable(task) else int(task or DONE)
    sys.stdout.flush()
    return code


class _UsageError(Exception):
    """The command line lacks something."""


def _usage_error(error: Any) -> str:
    text = " ".join(str(error.format_message()).split()).rstrip(".")
    return text[:1].lower() + text[1:]


def _help_of(error: Any) -> str:
    context = getattr(error, "ctx", None)
    command = getattr(context, "info_name", None) if getattr(context, "parent", None) else None
    return f"{command} --help" if command else "--help"


def _refuse(reason: str, code: int = BAD_INPUT) -> int:
    sys.stderr.write(f"pipeline-tracker: {' '.join(reason.split())}\n")
    return code


def _guard_ros_args(arguments: Sequence[str]) -> list[str]:
    """Keep ROS's arguments away from our own parser: they follow ``--ros-args``."""
    arguments = list(arguments)
    if "--ros-args" in arguments:
        place = arguments.index("--ros-args")
        if "--" not in arguments[:place]:
            arguments.insert(place, "--")
    return arguments


def _of_ros(arguments: Sequence[str] | None) -> list[str]:
    given = list(arguments or [])
    if given and given[0] != "--ros-args":
        raise _UsageError(f"{given[0]} is not understood; ROS's own arguments follow --ros-args")
    return given[1:]


def _number(option: str, text: str, kind: type[float]) -> float:
    try:
        return kind(text)
    except ValueError:
        expected = "an integer" if kind is int else "a number"
        raise _UsageError(f"{option} {text}: expected {expected}") from None


def _say(text: str) -> int:
    sys.stdout.write(f"{text}\n")
    return DONE


def _replay(
    bag: Path,
    output: Path | None,
    config: Path | None,
    overrides: list[str],
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
    from pipeline_tracker.replay import default_output, replay

    output = output or default_output(bag)
    outcome = replay(bag, settings, output, force=force, resume=resume)
    _say(outcome.text)
    if outcome.summary.interrupted:
        return _refuse(
            f"interrupted; what was computed is in {outcome.output}, --resume goes on with it",
            INTERRUPTED,
        )
    return DONE if outcome.summary.found else NEVER_FOUND


def _run(
    config: Path | None,
    overrides: list[str],
    separate: bool,
    ros_args: list[str],
    record: tuple[Path, bool] | None,
) -> int:
    from pipeline_tracker.nodes.launcher import Recording, run

    recording = None if record is None else Recording(*record)
    return run(config, overrides, separate, ros_args, recording)


def _play(bag: Path, rate: float, loop: bool, ros_args: list[str]) -> int:
    from pipeline_tracker.nodes.player import play

    return play(bag, rate, loop, ros_args)


def _info(bag: Path, config: Path | None, overrides: list[str], *, as_json: bool) -> int:
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
    found = bag_info(bag, settings, has_diameter=has_diameter)
    return _say(json.dumps(found.as_json(), indent=2) if as_json else found.in_words())


def _salvage(bag: Path, output: Path) -> int:
    from pipeline_tracker.bags.salvage import salvage

    return _say(salvage(bag, output).in_words())


def _list_scenarios() -> int:
    from pipeline_tracker.simulation import list_scenarios

    scenarios = list_scenarios()
    width = max(map(len, scenarios), default=0)
    return _say("\n".join(f"{name:<{width}}  {text}" for name, text in scenarios.items()))


def _simulate(scenario: str, output: Path, overrides: list[str], seed: int | None) -> int:
    from pipeline_tracker.simulation import simulate

    return _say(f"written to {simulate(scenario, output, overrides, seed)}")


def _evaluate(directory: Path, truth: Path, *, plots: bool, worst: int) -> int:
    from pipeline_tracker.evaluation import evaluate_command

    evaluate_command(directory, truth, plots=plots, worst=worst)
    return DONE


def _report(directory: Path, truth: Path | None) -> int:
    from pipeline_tracker.errors import BagError
    from pipeline_tracker.report.write import write_report

    evaluation = None
    if truth is not None:
        from pipeline_tracker.evaluation import evaluate

        evaluation = evaluate(directory, truth)
    try:
        return _say(f"written to {write_report(directory, evaluation)}")
    except OSError as error:
        raise BagError(f"{directory}: cannot be written ({error.strerror or error})") from None


def _overlay(
    directory: Path, output: Path, bag: Path | None, numbers: dict[str, Any], *, force: bool
) -> int:
    from pipeline_tracker.replay.film import Cut, write_film

    outcome = write_film(directory, output, Cut(**numbers), bag=bag, force=force)
    return _say(outcome.in_words())


def _export(
    directory: Path, form: str, output: Path | None, overrides: list[str], *, force: bool
) -> int:
    from pipeline_tracker.export import export

    return _say(export(directory, form, output, overrides, force=force).in_words())


def _print_schema() -> int:
    import json

    from pipeline_tracker.evaluation import evaluation_schema

    return _say(json.dumps(evaluation_schema(), indent=2))


def _benchmark(
    manifest: Path, output: Path, jobs: int, scheduler: str | None, *, force: bool
) -> int:
    from pipeline_tracker.benchmark import benchmark_command

    outcome = benchmark_command(manifest, output, jobs=jobs, scheduler=scheduler, force=force)
    if outcome.interrupted:
        return _refuse(
            f"interrupted; what is done is in {output}, the same command goes on with it",
            INTERRUPTED,
        )
    return DONE if outcome.whole else SOME_FAILED


def _limits(numbers: dict[str, float], spent: float | None, plot: Path | None) -> int:
    from pipeline_tracker.limits import Plan

    plan = Plan(**numbers)
    plan.check()
    _say(plan.in_words(spent))
    if plot is not None:
        from pipeline_tracker.report.limits_plot import write_limits_plot

        write_limits_plot(plan, plot, spent)
        _say(f"drawn in {plot}")
    return TOO_SLOW if spent is not None and spent > plan.time else DONE


def _bench(
    json_file: Path | None, sizes: str | None, overrides: tuple[str, ...], given: dict[str, Any]
) -> int:
    from pipeline_tracker.bench import BenchOptions, bench_command
    from pipeline_tracker.bench.options import SIZES, parse_sizes

    chosen = SIZES if sizes is None else parse_sizes(sizes)
    bench_command(BenchOptions(settings=overrides, sizes=chosen, **given), json_file)
    return DONE


def _doctor(*, as_json: bool, talk: bool) -> int:
    from pipeline_tracker.doctor import doctor_command

    return DONE if doctor_command(as_json=as_json, talk=talk) else SOMETHING_WRONG


if __name__ == "__main__":
    main()
