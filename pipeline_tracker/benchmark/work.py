"""What a worker process does: simulate a sea, or replay and measure a bag.

Nothing is raised here: whatever goes wrong is an outcome, so that it can be a line of the table.
"""

from __future__ import annotations

import csv
import io
import os
import socket
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from pipeline_tracker.benchmark.fingerprint import measuring_code, simulator_code
from pipeline_tracker.benchmark.plan import RunTask, SeaTask
from pipeline_tracker.benchmark.results import (
    RESULT_FILE,
    SEA_FILE,
    RunTimes,
    SeaTimes,
    read_run,
    read_sea,
    whole_directory,
)
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.evaluation import FILE_NAME, evaluate
from pipeline_tracker.replay import replay
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.simulation import simulate


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes:
        reason: why it failed, in one line; empty where it is done.
        details: the traceback of what should not have happened.
        seconds: how long it took.
        where: host and process.
    """

    reason: str = ""
    details: str = ""
    seconds: float = 0.0
    where: str = ""


@dataclass(frozen=True)
class Place:
    """Where a task is done.

    Attributes:
        root: the benchmark's directory, the same path on all machines.
        token: content of the file ``MARKER`` in it; tells that it is the same directory.
    """

    root: str
    token: str


MARKER = ".benchmark"


def make_sea(place: Place, task: SeaTask) -> Outcome:
    """Simulate a sea, unless it is there."""

    def work() -> None:
        _check(place, task.code, simulator_code())
        directory = Path(place.root, task.directory)
        if read_sea(directory) is not None:
            return
        with whole_directory(directory) as scratch:
            file = scratch.parent / "scenario.yaml"
            file.write_text(task.scenario, encoding="utf-8")
            start = time.monotonic()
            simulate(file, scratch, progress=False)
            times = SeaTimes(seconds_simulate=time.monotonic() - start, host=socket.gethostname())
            (scratch / SEA_FILE).write_text(times.model_dump_json(indent=2), encoding="utf-8")

    return _guarded(work)


def measure(place: Place, task: RunTask) -> Outcome:
    """Replay a bag and measure it against its truth, unless that is done."""

    def work() -> None:
        _check(place, task.code, measuring_code())
        directory = Path(place.root, task.directory)
        if read_run(directory) is not None:
            return
        with whole_directory(directory) as scratch:
            bag = Path(task.bag) if task.sea is None else Path(place.root, task.sea.directory)
            _measure(bag, task.settings, scratch, directory)

    return _guarded(work)


def _measure(bag: Path, settings_yaml: str, directory: Path, final: Path) -> None:
    file = directory.parent / "settings.yaml"
    file.write_text(settings_yaml, encoding="utf-8")
    outcome = replay(bag, load_settings(file), directory, stream=io.StringIO())
    if outcome.summary.interrupted:
        raise PipelineTrackerError("it was interrupted")
    evaluation = evaluate(directory, bag).model_copy(update={"replay": str(final)})
    (directory / FILE_NAME).write_text(evaluation.model_dump_json(indent=2), encoding="utf-8")
    times = RunTimes(
        seconds_replay=outcome.summary.seconds,
        median_ms=_median_ms(directory / "estimates.csv"),
        host=socket.gethostname(),
    )
    (directory / RESULT_FILE).write_text(times.model_dump_json(indent=2), encoding="utf-8")


def _median_ms(table: Path) -> float | None:
    with table.open(newline="", encoding="utf-8") as stream:
        cells = [row["processing_ms"] for row in csv.DictReader(stream)]
    times = [float(cell) for cell in cells if cell]
    return median(times) if times else None


def _check(place: Place, wanted: str, code: str) -> None:
    """See that this worker shares the directory and the code with whoever gave it the task."""
    host = socket.gethostname()
    try:
        token = Path(place.root, MARKER).read_text(encoding="utf-8")
    except OSError:
        token = ""
    if token != place.token:
        raise PipelineTrackerError(
            f"the worker on {host} does not see the benchmark's directory {place.root}; all "
            "workers need it under the same path, on a shared disk"
        )
    if code != wanted:
        raise PipelineTrackerError(
            f"the worker on {host} has another pipeline_tracker than the one that gave the task; "
            "install the same version there"
        )


def _guarded(work: Callable[[], None]) -> Outcome:
    start, reason, details = time.monotonic(), "", ""
    try:
        work()
    except PipelineTrackerError as error:
        reason = str(error)
    except MemoryError:
        reason = "out of memory"
    except Exception as error:  # noqa: BLE001 - a task's failure is a line of the table
        text = " ".join(str(error).split())
        reason = f"unexpected {type(error).__name__}" + (f": {text}" if text else "")
        details = traceback.format_exc()
    where = f"{socket.gethostname()}, process {os.getpid()}"
    return Outcome(" ".join(reason.split()), details, time.monotonic() - start, where)
