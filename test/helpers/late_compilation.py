"""Writes the compiled functions that the first frames would still have to wait for.

``late_compilation.py FILE`` runs the whole pipeline, and leaves what it made of the frames in a
file; ``late_compilation.py FILE STAGE`` runs one stage alone on what is there.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher
from rendering import SMALL, pair
from swim import settings_of
from synthetic_world import DOWN, SECOND, World, level_pose

from pipeline_tracker.pipeline import FrameResult, Pipeline, Stage, warm_up
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.settings_io import replace_settings
from pipeline_tracker.types import Image, PipeSegment
from pipeline_tracker.vectorization.vectorizer import Vectorizer

WORLD = World.with_pipe(heading=0.15, ahead=0.3, aside=0.1)


def compiled_functions() -> dict[str, int]:
    """Every compiled function of ours, with how many kinds of arguments it is compiled for."""
    return {
        f"{name}.{key}": len(value.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("pipeline_tracker.")
        for key, value in vars(module).items()
        if isinstance(value, Dispatcher) and value.__module__ == name
    }


WAYS = [{"recognition.technique": technique} for technique in ("auto", 1, 2, 3)]
WAYS.append({"tracking.refine": False})
POSES = [level_pose(x=0.25 * k) for k in range(5)]


def frames() -> Iterator[tuple[dict[str, Any], int]]:
    """Track the pipe, lose it and find it again, in all ways there are: settings and number."""
    return ((way, k) for way in WAYS for k in range(8))


def pictures() -> list[tuple[Image, Image]]:
    found = [pair(WORLD, pose, DOWN, seed=k) for k, pose in enumerate(POSES[:4])]
    return [*found, pair(World(WORLD.bed), POSES[4], DOWN, seed=4)]


def fed(pipeline: Pipeline | None, way: dict[str, Any], k: int) -> Pipeline:
    """Return the pipeline for a frame, with its pose; another one with other settings."""
    if pipeline is None or k == 0:
        pipeline = Pipeline(replace_settings(settings_of(), way), DOWN)
    pipeline.poses.add(round(0.5 * k * SECOND), POSES[k % 5])
    return pipeline


def run_all(file: Path) -> None:
    images, pipeline, results = pictures(), None, []
    for way, k in frames():
        pipeline = fed(pipeline, way, k)
        results.append(pipeline.process(round(0.5 * k * SECOND), SMALL, *images[k % 5]))
    file.write_bytes(pickle.dumps(results))


def run_stage(stage: Stage, file: Path) -> None:
    results: list[FrameResult] = pickle.loads(file.read_bytes())  # noqa: S301 - of run_all
    images = pictures() if stage is Stage.VECTORIZATION else []
    pipeline = None
    for (way, k), result in zip(frames(), results, strict=True):
        settings = replace_settings(settings_of(), way)
        if stage is Stage.VECTORIZATION:
            Vectorizer(settings).process(k, SMALL, *images[k % 5])
        elif stage is Stage.RECOGNITION:
            Recognizer(settings, DOWN).recognize(result.vectorized)
        else:
            pipeline = fed(pipeline, way, k)
            # What the recognizer answers comes from elsewhere.
            stamp = result.vectorized.stamp_ns
            none = PipeSegment.none(stamp, settings.radius)
            pipeline.follow(result.vectorized, result.recognition or none)


def main() -> None:
    file, stage = Path(sys.argv[1]), Stage[sys.argv[2]] if len(sys.argv) > 2 else None
    warm_up(stage)
    before = compiled_functions()
    if stage is None:
        run_all(file)
    else:
        run_stage(stage, file)
    for name, count in compiled_functions().items():
        if count > before.get(name, 0):
            sys.stdout.write(f"{name}\n")


if __name__ == "__main__":
    main()
