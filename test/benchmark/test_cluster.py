"""A real cluster on this machine: a scheduler and two worker processes."""

from __future__ import annotations

import asyncio
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from pipeline_tracker.benchmark import benchmark_command
from pipeline_tracker.benchmark.cluster import cluster_pool
from pipeline_tracker.errors import PipelineTrackerError

distributed = pytest.importorskip("distributed", reason="the extra [cluster] is not installed")

Write = Callable[..., Path]


@pytest.fixture
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs="CRITICAL",
    ) as made:
        yield made
        # One that is closed while it starts a killed worker again fails.
        with distributed.Client(made.scheduler_address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        for nanny in made.workers.values():
            made.sync(asyncio.wait_for, nanny.process.running.wait(), 60.0)


class Said(io.StringIO):
    """What a benchmark said, and how to wait for it."""

    def __init__(self) -> None:
        super().__init__()
        self._more = threading.Condition()

    def write(self, text: str) -> int:
        with self._more:
            count = super().write(text)
            self._more.notify_all()
        return count

    def wait_for(self, words: str, within: float) -> None:
        with self._more:
            assert self._more.wait_for(lambda: words in self.getvalue(), within), self.getvalue()


class Bench(threading.Thread):
    """A benchmark beside the test."""

    def __init__(self, manifest: Path, output: Path, address: str) -> None:
        super().__init__()
        self._arguments = manifest, output, address
        self.said = Said()
        self.outcome: Any = None

    def run(self) -> None:
        manifest, output, address = self._arguments
        self.outcome = benchmark_command(
            manifest,
            output,
            scheduler=address,
            console=Console(file=io.StringIO()),
            progress=Console(file=self.said, width=1000),
        )


def test_a_worker_killed_half_way_costs_nothing(
    cluster: Any, write_manifest: Write, tmp_path: Path
) -> None:
    manifest = write_manifest(
        "runs: [{scenario: demo, seeds: [1, 2]}]\nvariants: {a: {}, b: {sync.queue: 7}}\n"
    )
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        pids = client.run(os.getpid)
        assert len(set(pids.values())) == 2
        bench = Bench(manifest, tmp_path / "out", cluster.scheduler_address)
        bench.start()
        bench.said.wait_for(" of 6 ", within=120.0)
        victim, tasks = next((w, t) for w, t in client.processing().items() if t)
        ended = bench.said.getvalue().count(" of 6 ")
        os.kill(pids[victim], signal.SIGKILL)
        bench.join(timeout=120.0)
    assert tasks
    assert ended < 6
    assert bench.outcome is not None
    assert bench.outcome.whole, bench.said.getvalue()
    states = [line.state for line in bench.outcome.lines]
    assert states.count("done") == 4
    assert states.count("pooled") == 2
    said = bench.said.getvalue().splitlines()[1:]
    assert len(said) == 6
    # What came after it was done by others.
    assert all(f"process {pids[victim]})" not in line for line in said[ended + 2 :])


def test_a_worker_with_other_code_or_without_the_directory_says_so(
    cluster: Any, write_manifest: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = write_manifest("runs: [{scenario: demo}]")
    with monkeypatch.context() as patch:
        patch.setattr("pipeline_tracker.benchmark.plan.simulator_code", lambda: "other")
        bench = Bench(manifest, tmp_path / "one", cluster.scheduler_address)
        bench.run()
        (line,) = bench.outcome.lines
        assert line.state == "failed"
        assert "has another pipeline_tracker" in line.reason
    with monkeypatch.context() as patch:
        patch.setattr("pipeline_tracker.benchmark.command.write_whole", lambda *_: None)
        bench = Bench(manifest, tmp_path / "two", cluster.scheduler_address)
        bench.run()
        (line,) = bench.outcome.lines
        assert "does not see the benchmark's directory" in line.reason


def test_a_task_that_kills_every_worker_is_given_up(cluster: Any) -> None:
    from pipeline_tracker.benchmark.engine import outcome_of

    with cluster_pool(cluster.scheduler_address) as (executor, workers):
        assert workers == 2
        future = executor.submit(signal.raise_signal, signal.SIGKILL)
        future.exception(timeout=120)
        assert outcome_of(future).reason.startswith("worker died: ")


def test_a_scheduler_that_goes_away_is_no_traceback(
    write_manifest: Write, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    manifest = write_manifest("runs: [{scenario: demo, set: {frames: 500}}]")
    with distributed.LocalCluster(
        n_workers=1, processes=True, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        bench = Bench(manifest, tmp_path / "out", cluster.scheduler_address)
        bench.start()
        end = time.monotonic() + 60.0
        while not [*(tmp_path / "out").glob("seas/.unfinished-*")]:
            assert time.monotonic() < end
            # It ends with the benchmark, should that end before.
            bench.join(timeout=0.02)
            assert bench.is_alive(), bench.said.getvalue()
    bench.join(timeout=120.0)
    (line,) = bench.outcome.lines
    assert line.state == "failed"
    assert "the scheduler has gone" in line.reason
    assert "Traceback" not in capfd.readouterr().err


def test_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline_tracker.benchmark.cluster._TIMEOUT", 0.5)
    with (
        pytest.raises(PipelineTrackerError, match="no Dask scheduler answers there"),
        cluster_pool("tcp://127.0.0.1:1"),
    ):
        pass
    with (
        pytest.raises(PipelineTrackerError, match="--scheduler nonsense://x: no Dask scheduler"),
        cluster_pool("nonsense://x"),
    ):
        pass


def test_extra_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(PipelineTrackerError, match=r"pip install '\.\[cluster\]'"),
        cluster_pool("tcp://127.0.0.1:1"),
    ):
        pass
