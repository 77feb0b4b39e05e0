"""Worker processes on this machine, behind the interface of ``concurrent.futures``.

``ProcessPoolExecutor`` gives up on every task when one worker is killed, and cannot tell whose
worker it was. Here each task has a process to itself while it runs: a killed one costs one task.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import ParamSpec, TypeVar, cast

import cv2

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# A task that has cost this many workers their lives is given up.
_LIVES = 2
_ONE_THREAD = (
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
)
_environment_lock = threading.Lock()


class WorkerDiedError(Exception):
    """The process that did a task has ended before the task."""


class LocalPool(Executor):
    """Processes on this machine that each do one task at a time.

    A task whose worker dies is tried once more, then its future has ``WorkerDiedError``. When this
    process ends, however it ends, the workers end too.
    """

    def __init__(self, jobs: int) -> None:
        """Make a pool; processes start as they are needed.

        Args:
            jobs: number of processes. With more than one, each keeps to one thread.
        """
        self._one_thread = jobs > 1
        self._stopped = False
        self._idle: list[_Worker] = []
        self._busy: set[_Worker] = set()
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="worker")

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """Have a function called in a worker; it must be importable by name there."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers: after their tasks, or at once with ``cancel_futures``."""
        if cancel_futures:
            with self._lock:
                self._stopped = True
                for worker in self._busy:
                    worker.kill()
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            with self._lock:
                for worker in self._idle:
                    worker.close()
                self._idle.clear()

    def _call(self, fn: Callable[..., Result], args: object, kwargs: object) -> Result:
        for life in range(1, _LIVES + 1):
            worker = self._take()
            try:
                result = worker.call((fn, args, kwargs))
            except WorkerDiedError:
                self._drop(worker)
                if life == _LIVES or self._stopped:
                    raise
            except BaseException:
                self._put_back(worker)
                raise
            else:
                self._put_back(worker)
                return cast(Result, result)
        raise AssertionError

    def _take(self) -> _Worker:
        with self._lock:
            if self._stopped:
                raise WorkerDiedError("stopped")
            worker = self._idle.pop() if self._idle else _Worker(one_thread=self._one_thread)
            self._busy.add(worker)
            return worker

    def _put_back(self, worker: _Worker) -> None:
        with self._lock:
            self._busy.discard(worker)
            self._idle.append(worker)

    def _drop(self, worker: _Worker) -> None:
        with self._lock:
            self._busy.discard(worker)


@contextmanager
def local_pool(jobs: int) -> Iterator[tuple[LocalPool, int]]:
    """Give a pool and its number of workers; end all of them with the block."""
    pool = LocalPool(jobs)
    try:
        yield pool, jobs
    finally:
        pool.shutdown(cancel_futures=True)


class _Worker:
    """A process and the pipe to it."""

    def __init__(self, *, one_thread: bool) -> None:
        # A fresh interpreter: no locks, threads or compiled state of this process go along.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, one_thread), daemon=True)
        with _threads_of_children(one_thread=one_thread):
            self._process.start()
        theirs.close()

    def call(self, task: object) -> object:
        """Do a task, raise what it raises.

        Raises:
            WorkerDiedError: the process has ended before it was done.
        """
        try:
            self._pipe.send(task)
            done, value = self._pipe.recv()
        except (EOFError, OSError):
            self._process.kill()
            self._process.join()
            raise WorkerDiedError(_last_words(self._process.exitcode)) from None
        if not done:
            raise value
        return value

    def kill(self) -> None:
        self._process.kill()

    def close(self) -> None:
        self._pipe.close()
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _last_words(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f"the worker ended with exit code {exit_code}"
    with suppress(ValueError):
        name = signal.Signals(-exit_code).name
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return f"the worker was ended by {name}{hint}"
    return f"the worker was ended by signal {-exit_code}"


@contextmanager
def _threads_of_children(*, one_thread: bool) -> Iterator[None]:
    """Limit the threads of processes that are started meanwhile: libraries look as they load."""
    with _environment_lock:
        before = {name: os.environ.get(name) for name in _ONE_THREAD}
        try:
            if one_thread:
                os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


def _serve(pipe: Connection, one_thread: bool) -> None:
    """Do tasks until the other end is closed."""
    # Ctrl-C goes to all processes of a terminal; what becomes of workers is the pool's business.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if one_thread:
        cv2.setNumThreads(1)
    while True:
        try:
            fn, args, kwargs = pipe.recv()
        except EOFError:
            return
        try:
            answer = True, fn(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 - it is raised at the other end
            answer = False, error
        pipe.send(answer)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
