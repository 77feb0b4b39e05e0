"""Very many frames through the nodes: memory stays flat, and every frame is answered.

``python test/soak/frames.py --frames 100000`` starts the four nodes in one process, as
``pipeline-tracker run`` has them, and publishes the demo's pairs, cut and scaled to 320 x 240, to
and fro over DDS. The next pair is published as soon as an answer comes, so that the rate is the
highest that the nodes hold; a frame without an answer within 10 s counts as lost. ``--in-process``
calls the pipeline instead. Exit 1 where a frame is lost, memory grows, or threads or files do.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from pipeline_tracker.bench.candidates import process_stop
from pipeline_tracker.bench.live import _READY_WITHIN, Load, _live_settings, _running
from pipeline_tracker.bench.memory import MEGABYTE
from pipeline_tracker.bench.recording import Recording, read_recording, to_and_fro
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.settings_io import dump_settings
from pipeline_tracker.types import State

SIZE = (320, 240)
LOST_AFTER = 10.0
IN_FLIGHT = 2
LOOKS, BLOCKS = 2000, 20
# What 100,000 frames may cost at most, MB.
GROWTH = 10.0
# Left out at the beginning of what is told.
SHARES = 0.5, 0.1
Array = NDArray[np.float64]


# What is looked at: the process's own memory, what it shares with others (the segments of DDS, of
# a fixed size, and the libraries), threads, open files.
OWN, SHARED, THREADS, FILES = range(4)


class Watch:
    """Memory, threads and files of a process, now and then."""

    def __init__(self, process: psutil.Process, frames: int) -> None:
        self._process = process
        self._every = max(1, frames // LOOKS)
        # All of it at once, and touched: in the process that is watched, this must not grow.
        self._seen = np.full((1 + frames // self._every, 5), np.nan)
        self._count = 0

    def look(self, number: int) -> None:
        if number % self._every:
            return
        memory = self._process.memory_info()
        own, shared = (memory.rss - memory.shared) / MEGABYTE, memory.shared / MEGABYTE
        things = self._process.num_threads(), self._process.num_fds()
        self._seen[self._count] = own, shared, *things, number
        self._count += 1

    def values(self, what: int) -> Array:
        return self._seen[: self._count, what]

    def settled(self, what: int) -> Array:
        return self.values(what)[self._count // 10 :]

    def slope(self, what: int, left_out: float) -> tuple[float, float]:
        """Return growth and its standard error, MB for 1,000 frames, a share left out at first.

        From the means of blocks: what neighbours have in common is not counted twice.
        """
        first = int(left_out * self._count)
        numbers, values = self.values(-1)[first:], self.values(what)[first:]
        x = np.array([b.mean() for b in np.array_split(numbers, BLOCKS)]) / 1000.0
        y = np.array([b.mean() for b in np.array_split(values, BLOCKS)])
        (growth, _), covariance = np.polyfit(x, y, 1, cov=True)
        return float(growth), float(np.sqrt(covariance[0, 0]))


@dataclass
class Soak:
    """What came of it."""

    frames: int = 0
    lost: int = 0
    valid: int = 0
    start: float = field(default_factory=time.monotonic)
    seconds: float = 0.0

    def ended(self) -> Soak:
        self.seconds = time.monotonic() - self.start
        return self


def in_process(recording: Recording, frames: int, watch: Watch) -> Soak:
    done = Soak()
    pipeline = Pipeline(recording.settings, recording.mounting)
    for stop in to_and_fro(recording):
        if stop.number >= frames:
            break
        result = process_stop(pipeline, recording, stop)
        done.frames += 1
        done.valid += result.tracked.status.state is State.TRACKING
        watch.look(stop.number)
    return done.ended()


def over_dds(recording: Recording, frames: int, watch: Watch, probe: Any) -> Soak:
    done = Soak()
    heard = probe._heard
    waiting: dict[int, float] = {}
    for stop in to_and_fro(recording):
        if stop.number >= frames:
            break
        left, right = (probe._image(image) for image in (stop.pair.left, stop.pair.right))
        probe._publish([left, right], stop.pair.pose)
        waiting[heard.stamps[-1]] = time.monotonic()
        done.frames += 1
        settle(probe, waiting, done, at_most=IN_FLIGHT - 1)
        watch.look(stop.number)
    settle(probe, waiting, done, at_most=0)
    return done.ended()


def settle(probe: Any, waiting: dict[int, float], done: Soak, *, at_most: int) -> None:
    """Wait for answers until so many frames are under way."""
    heard = probe._heard
    while len(waiting) > at_most:
        probe._executor.spin_once(timeout_sec=0.05)
        for stamp in [stamp for stamp in waiting if stamp in heard.answers]:
            waiting.pop(stamp)
            done.valid += heard.answers.pop(stamp).valid
        for stamp, since in list(waiting.items()):
            if time.monotonic() - since > LOST_AFTER:
                waiting.pop(stamp)
                done.lost += 1


def run_nodes(
    recording: Recording, frames: int, make: Callable[[Any], Watch]
) -> tuple[Soak, Watch]:
    from pipeline_tracker.nodes.latency_probe import LatencyProbe
    from pipeline_tracker.nodes.process import prepare_transport

    prepare_transport(local=True)
    with tempfile.TemporaryDirectory() as name:
        config = Path(name) / "settings.yaml"
        config.write_text(dump_settings(_live_settings(recording)), encoding="utf-8")
        with _running(config, Load(1.0), {}, 5 * _READY_WITHIN) as nodes:
            probe = LatencyProbe(recording.rig, nodes.domain, recording.settings.frames.odom)
            try:
                probe.wait_for_nodes()
                (process,) = nodes.members()
                watch = make(process)
                return over_dds(recording, frames, watch, probe), watch
            finally:
                probe.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--in-process", action="store_true")
    given = parser.parse_args()
    # The nodes must not outlive this process.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    recording = read_recording(None).resized(SIZE)

    def make(process: psutil.Process) -> Watch:
        return Watch(process, given.frames)

    if given.in_process:
        watch = make(psutil.Process())
        done = in_process(recording, given.frames, watch)
    else:
        done, watch = run_nodes(recording, given.frames, make)
    growth, error = watch.slope(OWN, 0.5)
    threads, files = watch.settled(THREADS), watch.settled(FILES)
    sys.stdout.write(
        f"{done.frames} frames of {SIZE[0]} x {SIZE[1]} in {done.seconds:.0f} s, "
        f"{done.frames / done.seconds:.1f} a second; {done.lost} lost, {done.valid} valid\n"
        f"{in_words(watch, OWN, 'own memory')}\n{in_words(watch, SHARED, 'shared memory')}\n"
        f"threads {np.unique(threads).astype(int)}, open files {np.unique(files).astype(int)}\n"
    )
    grows = growth - 2.0 * error > GROWTH / 100.0
    steady = threads[-1] == threads[0] and files[-1] == files[0]
    return int(done.lost > 0 or grows or not steady)


def in_words(watch: Watch, what: int, name: str) -> str:
    used = watch.values(what)
    late, early = (
        f"{growth:.4f} +- {error:.4f}" for growth, error in map(partial(watch.slope, what), SHARES)
    )
    return (
        f"{name} {used[0]:.1f} MB at first, {used[-1]:.1f} MB at last; growth for 1,000 frames "
        f"{late} MB in the last half, {early} MB in the last nine tenths (standard errors)"
    )


if __name__ == "__main__":
    sys.exit(main())
