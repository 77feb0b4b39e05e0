from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import CancelledError

import pytest
from processes import ends, is_alive

from pipeline_tracker.benchmark.local_pool import LocalPool, WorkerDiedError, local_pool


def wait_for(condition: Callable[[], object], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come in time"
        time.sleep(0.02)


def pids(pool: LocalPool) -> list[int]:
    return [worker._process.pid or 0 for worker in pool._busy]


def test_results_and_errors_come_back() -> None:
    with local_pool(1) as (pool, workers):
        assert workers == 1
        assert pool.submit(divmod, 7, 2).result() == (3, 1)
        with pytest.raises(ZeroDivisionError):
            pool.submit(divmod, 7, 0).result()
        first, second = (pool.submit(os.getpid).result() for _ in range(2))
        assert first == second != os.getpid()


def test_workers_keep_to_one_thread_where_there_are_several() -> None:
    before = dict(os.environ)
    with local_pool(2) as (pool, _):
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert pool.submit(os.getenv, "NUMBA_NUM_THREADS").result() == "1"
    assert dict(os.environ) == before


def test_a_task_that_kills_its_worker_costs_no_other() -> None:
    with local_pool(2) as (pool, _):
        others = [pool.submit(divmod, n, 3) for n in range(4)]
        killed = pool.submit(signal.raise_signal, signal.SIGKILL)
        ended = pool.submit(os._exit, 3)
        others += [pool.submit(divmod, n, 3) for n in range(4, 8)]
        with pytest.raises(WorkerDiedError, match=r"by SIGKILL \(out of memory\?\)"):
            killed.result()
        with pytest.raises(WorkerDiedError, match="exit code 3"):
            ended.result()
        assert [other.result() for other in others] == [divmod(n, 3) for n in range(8)]


def test_a_task_whose_worker_is_killed_is_done_by_another() -> None:
    with local_pool(1) as (pool, _):
        task = pool.submit(time.sleep, 0.5)
        wait_for(lambda: pids(pool))
        (pid,) = pids(pool)
        os.kill(pid, signal.SIGKILL)
        assert task.result(timeout=60) is None
        assert not is_alive(pid)


def test_leaving_ends_what_is_running_at_once() -> None:
    start = time.monotonic()
    with local_pool(1) as (pool, _):
        running, waiting = pool.submit(time.sleep, 100), pool.submit(time.sleep, 100)
        wait_for(lambda: pids(pool))
        (pid,) = pids(pool)
    assert time.monotonic() - start < 60
    assert not is_alive(pid)
    with pytest.raises(WorkerDiedError):
        running.result()
    with pytest.raises(CancelledError):
        waiting.result()


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_workers_end_with_a_killed_parent() -> None:
    code = (
        "import os, time\n"
        "from pipeline_tracker.benchmark.local_pool import local_pool\n"
        "if __name__ == '__main__':\n"
        "    with local_pool(1) as (pool, _):\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n"
        "        pool.submit(time.sleep, 100).result()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert is_alive(worker)
        parent.kill()
    assert ends(worker)
