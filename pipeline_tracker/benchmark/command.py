"""The command: read the manifest, do what is missing, write the table."""

from __future__ import annotations

import importlib
import secrets
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console

from pipeline_tracker.benchmark.calibration import valid_frames, write_calibration
from pipeline_tracker.benchmark.cluster import cluster_pool
from pipeline_tracker.benchmark.engine import Engine
from pipeline_tracker.benchmark.lines import Line, make_lines
from pipeline_tracker.benchmark.local_pool import local_pool
from pipeline_tracker.benchmark.manifest import Manifest, find_manifest, read_manifest
from pipeline_tracker.benchmark.page import as_html
from pipeline_tracker.benchmark.plan import make_plan
from pipeline_tracker.benchmark.progress import BenchmarkProgress
from pipeline_tracker.benchmark.results import clear_unfinished
from pipeline_tracker.benchmark.tables import as_csv, as_json
from pipeline_tracker.benchmark.terminal import print_tables
from pipeline_tracker.benchmark.work import MARKER, Place
from pipeline_tracker.errors import ManifestError
from pipeline_tracker.files import write_whole

# Windows has none.
_fcntl: Any = importlib.import_module("fcntl") if find_spec("fcntl") else None

FILES = ("benchmark.csv", "benchmark.json", "benchmark.html")
_FAILURES = "failures.txt"


@dataclass(frozen=True)
class BenchmarkOutcome:
    """What came of a benchmark.

    Attributes:
        lines: the table.
        interrupted: whether it was stopped before its end.
    """

    lines: list[Line]
    interrupted: bool

    @property
    def whole(self) -> bool:
        """Whether every run is done."""
        return all(line.state in ("done", "pooled") for line in self.lines)


def benchmark_command(
    path: Path,
    output: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    force: bool = False,
    console: Console | None = None,
    progress: Console | None = None,
) -> BenchmarkOutcome:
    """Carry out a manifest and write its table; what is done already is not done again.

    Args:
        path: the manifest, or the name of one that comes with the package.
        output: the benchmark's directory; made, or one of an earlier benchmark.
        jobs: number of processes on this machine.
        scheduler: address of a Dask scheduler, whose workers take the place of these processes.
        force: whether runs that are done are done again; seas are kept.
        console: where the tables are printed; standard output by default.
        progress: where progress is told; standard error by default.

    Raises:
        ManifestError: the manifest is wrong, or the directory cannot be used.
        PipelineTrackerError: the scheduler does not answer, or the extra is not installed.
    """
    path = find_manifest(path)
    manifest = read_manifest(path)
    plan = make_plan(manifest, path)
    with _directory(output) as place:
        pool = local_pool(jobs) if scheduler is None else cluster_pool(scheduler)
        engine = Engine(plan, place, force=force)
        with BenchmarkProgress(plan, engine, progress or Console(stderr=True)) as shown:
            interrupted = _work(engine, pool, shown)
        lines = make_lines(plan, output, engine.outcomes)
        _write(output, lines, path, manifest, shown.details)
        pictures = write_calibration(valid_frames(plan, output), output)
    console = console or Console()
    print_tables(lines, console)
    console.print(
        f"written to {output}: {', '.join([*FILES, *(p.name for p in pictures)])}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    return BenchmarkOutcome(lines, interrupted)


def _work(
    engine: Engine, pool: AbstractContextManager[tuple[Executor, int]], shown: BenchmarkProgress
) -> bool:
    """Do what is to be done; tell whether it was interrupted."""
    if not engine.todo:
        return False
    try:
        with _end_as_interrupted(), pool as (executor, workers):
            shown.start(workers)
            engine.go(executor, shown.told)
    except KeyboardInterrupt:
        return True
    return False


@contextmanager
def _directory(output: Path) -> Iterator[Place]:
    """Take a directory for this command alone."""
    marker = output / MARKER
    try:
        if output.exists() and not output.is_dir():
            raise ManifestError(f"{output}: is a file, expected a directory for --output")
        output.mkdir(parents=True, exist_ok=True)
        first = next(iter(sorted(output.iterdir())), None)
        if first is not None and not marker.is_file():
            raise ManifestError(
                f"{output}: is not empty (it has {first.name}) and no benchmark's directory; "
                "name another with --output"
            )
        with _lock(output / ".lock", output):
            token = secrets.token_hex(8)
            write_whole(marker, token)
            for name in ("seas", "runs"):
                (output / name).mkdir(exist_ok=True)
                clear_unfinished(output / name)
            yield Place(str(output.resolve()), token)
    except OSError as error:
        raise ManifestError(
            f"{output}: cannot be written ({error.strerror or error}); make room there, or name "
            "another directory with --output"
        ) from None


@contextmanager
def _lock(path: Path, output: Path) -> Iterator[None]:
    """Keep a second benchmark out; a killed one leaves no lock."""
    if _fcntl is None:
        yield
        return
    with path.open("a") as stream:
        try:
            _fcntl.flock(stream, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
        except OSError:
            raise ManifestError(
                f"{output}: another benchmark is at work in it; wait for its end, or name another "
                "directory with --output"
            ) from None
        yield


@contextmanager
def _end_as_interrupted() -> Iterator[None]:
    """Take SIGTERM for Ctrl-C, so that workers are ended and what is done is written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _write(
    output: Path, lines: list[Line], path: Path, manifest: Manifest, details: list[str]
) -> None:
    write_whole(output / "benchmark.csv", as_csv(lines))
    write_whole(output / "benchmark.json", as_json(lines, path, manifest.description))
    write_whole(output / "benchmark.html", as_html(lines, path, manifest.description))
    if details:
        write_whole(output / _FAILURES, "\n".join(details))
    else:
        (output / _FAILURES).unlink(missing_ok=True)
