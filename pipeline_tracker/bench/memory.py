"""Whether memory stays flat over many pairs."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from pipeline_tracker.bench.candidates import process_stop
from pipeline_tracker.bench.recording import Recording, to_and_fro
from pipeline_tracker.bench.schema import Memory
from pipeline_tracker.errors import BenchError
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.types import State

MEGABYTE = 1e6
_LOOKS = 200


def process_tools(option: str) -> Any:
    """Return psutil.

    Args:
        option: what needs it, for the error.

    Raises:
        BenchError: it is not installed.
    """
    if find_spec("psutil") is None:
        raise BenchError(
            f"{option} needs psutil, which is not installed; pip install '.[bench]' in the clone"
        )
    return import_module("psutil")


def measure_memory(recording: Recording, frames: int) -> Memory:
    """Process many pairs in this process and watch its memory.

    Args:
        recording: what to process, to and fro.
        frames: pairs.

    Raises:
        BenchError: psutil is not installed.
    """
    process = process_tools("--frames").Process()
    pipeline = Pipeline(recording.settings, recording.mounting)
    every = max(1, frames // _LOOKS)
    numbers: list[int] = []
    used: list[float] = []
    tracked = 0
    for stop in to_and_fro(recording):
        if stop.number >= frames:
            break
        result = process_stop(pipeline, recording, stop)
        tracked += result.tracked.status.state is State.TRACKING and result.recognition is None
        if stop.number % every == every - 1 or stop.number == frames - 1:
            numbers.append(stop.number)
            used.append(process.memory_info().rss / MEGABYTE)
    settled = [k for k, number in enumerate(numbers) if number >= frames // 10]
    x, y = np.array(numbers)[settled], np.array(used)[settled]
    slope = float(np.polyfit(x, y, 1)[0]) if len(settled) > 1 else 0.0
    return Memory(
        frames=frames,
        tracked=tracked,
        start_mb=float(y[0]),
        end_mb=float(y[-1]),
        most_mb=float(max(used)),
        growth_mb_per_1000=1000.0 * slope,
    )
