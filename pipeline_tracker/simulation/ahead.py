"""Making things ahead of their use, on all cores, in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")
Made = TypeVar("Made")


def made_ahead(
    make: Callable[[Job], Made], jobs: Iterable[Job], workers: int
) -> Generator[Made, None, None]:
    """Yield ``make(job)`` for each job, in order; while one is used the next ones are made.

    At most ``workers`` are in the making or wait at a time. When the caller stops, or one raises an
    error, those not begun are never made.

    Args:
        make: called in threads of its own; it must not depend on the order of calls.
        jobs: what to make.
        workers: number of threads.
    """
    waiting: deque[Future[Made]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for job in jobs:
                if len(waiting) == workers:
                    yield waiting.popleft().result()
                waiting.append(pool.submit(make, job))
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
