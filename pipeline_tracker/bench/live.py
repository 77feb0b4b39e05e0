"""The nodes as they run on a vehicle: latency over DDS, drops, CPU, memory, time until ready."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from pipeline_tracker.bench.machine import load_average
from pipeline_tracker.bench.memory import MEGABYTE, process_tools
from pipeline_tracker.bench.recording import Recording, to_and_fro
from pipeline_tracker.bench.schema import Live, LiveRow
from pipeline_tracker.errors import BenchError
from pipeline_tracker.nodes.process import prepare_transport, require_ros
from pipeline_tracker.settings_io import dump_settings, replace_settings

SECONDS = 20.0
_NODES = 4
_READY_WITHIN, _COLD_WITHIN = 60.0, 300.0
_END_WITHIN = 5.0
_LOOK_EVERY = 0.02
_WATCH_EVERY = 0.5
# Above 101, Linux gives the ports to others.
_DOMAINS = 100


@dataclass(frozen=True)
class Load:
    """One row: pairs a second, processes, and whether the nodes are kept to one core."""

    hertz: float
    processes: int = 1
    one_core: bool = False


LOADS = (Load(10.0), Load(10.0, 4), Load(20.0), Load(20.0, 4), Load(20.0, one_core=True))


def check_live(recording: Recording) -> None:
    """Check that live nodes can be measured here.

    Raises:
        RosMissingError: ROS is not installed.
        BenchError: psutil is not, or there is one camera only.
    """
    require_ros("bench --live")
    process_tools("--live")
    if recording.rig.right is None:
        raise BenchError("--live: the bag has one camera, expected a stereo pair")


def measure_live(
    recording: Recording,
    tell: Callable[[str], None],
    loads: tuple[Load, ...] = LOADS,
    seconds: float = SECONDS,
    *,
    cold: bool = True,
) -> Live:
    """Run the nodes under each load.

    Args:
        recording: of the size to be measured.
        tell: called with what is done.
        loads: the rows.
        seconds: how long each.
        cold: measure the start with nothing compiled too.

    Raises:
        BenchError: the nodes do not get ready.
    """
    prepare_transport(local=True)
    rows = []
    with tempfile.TemporaryDirectory(prefix="pipeline_tracker_bench_") as name:
        directory = Path(name)
        config = directory / "settings.yaml"
        config.write_text(dump_settings(_live_settings(recording)), encoding="utf-8")
        for load in loads:
            tell(f"live: {load.hertz:g} Hz, {load.processes} process(es), {seconds:g} s")
            rows.append(_measure(recording, config, load, seconds))
        ready_cold = 0.0
        if cold:
            tell("live: start with nothing compiled")
            cache = {"NUMBA_CACHE_DIR": str(directory / "cache")}
            with _running(config, Load(1.0), cache, _COLD_WITHIN) as nodes:
                ready_cold = nodes.ready_s
    width, height = recording.size
    return Live(width=width, height=height, ready_cold_s=ready_cold, rows=rows)


def _live_settings(recording: Recording) -> Any:
    # To and fro in less time than was recorded looks like jumps of the pose.
    changes = {
        "image_transport": "raw",
        "pose_type": "pose",
        "mode": "stereo",
        "use_sim_time": False,
        "pose.max_speed": 1000.0,
        # How late an answer is is measured here, and judged by whoever reads it.
        "output.timeout": 60.0,
        "image.max_age": 60.0,
    }
    return replace_settings(recording.settings, changes)


@dataclass
class _Nodes:
    """The running nodes: their processes, ROS domain, and time until ready."""

    family: Any
    domain: int
    ready_s: float

    def members(self) -> list[Any]:
        """The nodes' processes: those of the launcher, and itself where it has none."""
        children: list[Any] = self.family.children(recursive=True)
        return children or [self.family]

    def cpu_seconds(self) -> float:
        """CPU time spent so far, s."""
        return sum(sum(process.cpu_times()[:2]) for process in self.members())

    def memory(self) -> float:
        """Resident memory, bytes."""
        return float(sum(process.memory_info().rss for process in self.members()))


@contextmanager
def _running(config: Path, load: Load, more: dict[str, str], within: float) -> Iterator[_Nodes]:
    """Start the nodes, wait until they are ready, and end them afterwards."""
    tools = process_tools("--live")
    domain = 1 + (os.getpid() + time.monotonic_ns() // 1_000_000) % _DOMAINS
    arguments = ["run", "--config", str(config), *(["--separate"] if load.processes > 1 else [])]
    command = [sys.executable, "-m", "pipeline_tracker.cli", *arguments]
    with tempfile.TemporaryFile() as log:
        start = time.monotonic()
        child = subprocess.Popen(  # noqa: S603 - our own command
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "ROS_DOMAIN_ID": str(domain), **more},
        )
        try:
            family = tools.Process(child.pid)
            if load.one_core and hasattr(family, "cpu_affinity"):
                # At once, while there is one thread: all others have it from that one.
                family.cpu_affinity([max(family.cpu_affinity())])
            _wait_until_ready(child, log, start + within)
            yield _Nodes(family, domain, time.monotonic() - start)
        finally:
            child.terminate()
            try:
                child.wait(_END_WITHIN)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _wait_until_ready(child: subprocess.Popen[bytes], log: Any, deadline: float) -> None:
    while True:
        # The child writes at the end of the same open file; `pread` leaves its place alone.
        size = os.fstat(log.fileno()).st_size
        text = os.pread(log.fileno(), size, 0).decode(errors="replace")
        if len(set(re.findall(r"\[(\w+)\]: ready", text))) >= _NODES:
            return
        last = " ".join(text.split())[-300:] or "they said nothing"
        if child.poll() is not None:
            raise BenchError(f"--live: the nodes ended with exit code {child.returncode}: {last}")
        if time.monotonic() > deadline:
            raise BenchError(f"--live: the nodes were not ready in time: {last}")
        time.sleep(_LOOK_EVERY)


def _measure(recording: Recording, config: Path, load: Load, seconds: float) -> LiveRow:
    # Only here: rclpy need not be there for the rest.
    probe_module = import_module("pipeline_tracker.nodes.latency_probe")
    with _running(config, load, {}, _READY_WITHIN) as nodes:
        probe = probe_module.LatencyProbe(
            recording.rig, nodes.domain, recording.settings.frames.odom
        )
        most = [0.0]
        looked = [0.0]

        def look() -> None:
            now = time.monotonic()
            if now - looked[0] >= _WATCH_EVERY:
                looked[0] = now
                with contextlib.suppress(process_tools("--live").NoSuchProcess):
                    most[0] = max(most[0], nodes.memory())

        try:
            probe.wait_for_nodes()
            spent, start = nodes.cpu_seconds(), time.monotonic()
            heard = probe.run(
                (
                    (stop.pair.left, stop.pair.right, stop.pair.pose)
                    for stop in to_and_fro(recording)
                ),
                load.hertz,
                round(seconds * load.hertz),
                look,
            )
            spent, passed = nodes.cpu_seconds() - spent, time.monotonic() - start
        finally:
            probe.close()
    milliseconds = [1e3 * answer.seconds for answer in heard.answers.values()]
    load_now = load_average()
    first = heard.answers.get(heard.stamps[0])
    return LiveRow(
        hertz=load.hertz,
        processes=load.processes,
        one_core=load.one_core,
        ready_s=nodes.ready_s,
        published=len(heard.stamps),
        answered=len(milliseconds),
        valid=sum(answer.valid for answer in heard.answers.values()),
        dropped=len(heard.stamps) - len(milliseconds),
        first_ms=None if first is None else 1e3 * first.seconds,
        p50_ms=_quantile(milliseconds, 0.5),
        p99_ms=_quantile(milliseconds, 0.99),
        max_ms=_quantile(milliseconds, 1.0),
        load=load_now[0] if load_now else None,
        cpu_percent=100.0 * spent / passed,
        memory_mb=most[0] / MEGABYTE,
    )


def _quantile(values: list[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None
