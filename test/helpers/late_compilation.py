"""Writes the compiled functions that the first frames would still have to wait for."""

from __future__ import annotations

import sys

from numba.core.dispatcher import Dispatcher
from rendering import SMALL, pair
from swim import settings_of
from synthetic_world import DOWN, SECOND, World, level_pose

from pipeline_tracker.pipeline import Pipeline, warm_up
from pipeline_tracker.settings_io import replace_settings

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


def main() -> None:
    """Track the pipe, lose it and find it again, in all ways there are."""
    poses = [level_pose(x=0.25 * k) for k in range(5)]
    pictures = [pair(WORLD, pose, DOWN, seed=k) for k, pose in enumerate(poses[:4])]
    pictures.append(pair(World(WORLD.bed), poses[4], DOWN, seed=4))
    settings = settings_of()
    warm_up()
    before = compiled_functions()
    ways = [{"recognition.technique": technique} for technique in ("auto", 1, 2, 3)]
    for changes in (*ways, {"tracking.refine": False}):
        pipeline = Pipeline(replace_settings(settings, changes), DOWN)
        for k in range(8):
            stamp = round(0.5 * k * SECOND)
            pipeline.poses.add(stamp, poses[k % 5])
            pipeline.process(stamp, SMALL, *pictures[k % 5])
    for name, count in compiled_functions().items():
        if count > before.get(name, 0):
            sys.stdout.write(f"{name}\n")


if __name__ == "__main__":
    main()
