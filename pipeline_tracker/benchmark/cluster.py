"""Workers of a Dask cluster, behind the interface of ``concurrent.futures``."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

from pipeline_tracker.errors import PipelineTrackerError

# To find the scheduler, s.
_TIMEOUT = 15.0


# What becomes of tasks is told by us; a scheduler that goes away is not told by tracebacks.
_TALKATIVE = ("distributed", "distributed.client", "distributed.utils", "tornado")


@contextmanager
def _quiet() -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in _TALKATIVE]
    before = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def cluster_pool(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to a cluster; give its executor and its number of threads at present.

    A task whose worker dies goes to another one; the scheduler gives it up when it has cost
    several of them their lives (its setting ``distributed.scheduler.allowed-failures``).

    Args:
        address: of the scheduler, such as ``tcp://192.168.0.10:8786``.

    Raises:
        PipelineTrackerError: dask.distributed is not installed, or there is no such scheduler.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PipelineTrackerError(
            f"--scheduler {address}: no Dask scheduler answers there ({reason}); start one with "
            "`dask scheduler` and give its address, such as tcp://192.168.0.10:8786"
        ) from None
    with _quiet():
        try:
            executor = client.get_executor(pure=False)
            try:
                yield executor, sum(client.nthreads().values())
            finally:
                executor.shutdown(wait=False)
        finally:
            client.close(timeout=_TIMEOUT)


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise PipelineTrackerError(
            f"--scheduler needs dask.distributed, which cannot be imported ({error}); install the "
            "extra: pip install '.[cluster]' in the clone"
        ) from None
