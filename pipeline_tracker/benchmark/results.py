"""What tasks leave behind: whole directories, or none."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline_tracker.evaluation import FILE_NAME, Evaluation

RESULT_FILE = "run.json"
SEA_FILE = "sea.json"
_SCRATCH = ".unfinished-"


class RunTimes(BaseModel):
    """What ``run.json`` holds: how long a replay took."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seconds_replay: float = Field(description="The replay's frames, without start and compiling")
    median_ms: float | None = Field(description="Median time of a frame; null without frames")
    host: str = Field(description="Where it ran")


class SeaTimes(BaseModel):
    """What ``sea.json`` holds: how long a simulation took."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seconds_simulate: float = Field(description="Of all pairs, the making of the scene included")
    host: str = Field(description="Where it ran")


@dataclass(frozen=True)
class RunResult:
    """A replay that was measured."""

    times: RunTimes
    evaluation: Evaluation


def read_run(directory: Path) -> RunResult | None:
    """Return what a run left behind; None where it is not there whole."""
    try:
        times = RunTimes.model_validate_json((directory / RESULT_FILE).read_bytes())
        evaluation = Evaluation.model_validate_json((directory / FILE_NAME).read_bytes())
    except (OSError, ValidationError):
        return None
    return RunResult(times, evaluation)


def read_sea(directory: Path) -> SeaTimes | None:
    """Return what the simulation of a sea left beside its bag; None where it is not whole."""
    try:
        return SeaTimes.model_validate_json((directory / SEA_FILE).read_bytes())
    except (OSError, ValidationError):
        return None


@contextmanager
def whole_directory(directory: Path) -> Iterator[Path]:
    """Give a place of the same name to write to, and put it in its place once it is whole.

    When the block ends with an error nothing is left behind; when the process is killed, a hidden
    directory that ``clear_unfinished`` takes away. Where another process has put the same directory
    in its place meanwhile, that one is kept.
    """
    directory.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=_SCRATCH, dir=directory.parent))
    try:
        yield scratch / directory.name
        try:
            (scratch / directory.name).replace(directory)
        except OSError:
            if not directory.is_dir():
                raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def remove(directory: Path) -> None:
    """Remove a directory so that it is never seen half."""
    if directory.exists():
        scratch = Path(tempfile.mkdtemp(prefix=_SCRATCH, dir=directory.parent))
        directory.replace(scratch / directory.name)
        shutil.rmtree(scratch, ignore_errors=True)


def clear_unfinished(parent: Path) -> None:
    """Remove what killed processes left in a directory."""
    for scratch in parent.glob(f"{_SCRATCH}*"):
        shutil.rmtree(scratch, ignore_errors=True)
