"""Timing candidates side by side: one round each in turn, so that a busy machine hits all alike."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import cv2
import numba
import numpy as np

Round = TypeVar("Round")


@dataclass(frozen=True)
class Candidate(Generic[Round]):
    """Something that is timed.

    Attributes:
        key: name in the JSON.
        label: name in the table.
        run: what is timed; called with the round.
        settle: called with the round and the answer, not timed; False where the answer is not
            what is to be timed (the pipe was not tracked, for example). None: all answers are.
    """

    key: str
    label: str
    run: Callable[[Round], Any]
    settle: Callable[[Round, Any], bool] | None = None


@dataclass
class Times:
    """Durations of one candidate.

    Attributes:
        milliseconds: of each round that counts, ms.
        rounds: all rounds.
    """

    milliseconds: list[float] = field(default_factory=list)
    rounds: int = 0

    @property
    def minimum(self) -> float | None:
        """Shortest, ms; None where no round counts."""
        return self.quantile(0.0)

    @property
    def median(self) -> float | None:
        """Median, ms; None where no round counts."""
        return self.quantile(0.5)

    def quantile(self, share: float) -> float | None:
        """Return a quantile, ms; None where no round counts."""
        return float(np.quantile(self.milliseconds, share)) if self.milliseconds else None


def interleave(
    candidates: Sequence[Candidate[Round]],
    rounds: Iterator[Round],
    count: int,
    *,
    warm_up: int = 2,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Times]:
    """Time candidates: A B C, B C A, C A B and so on.

    Args:
        candidates: with keys that differ.
        rounds: what each round works on; made outside of the times.
        count: rounds that are timed.
        warm_up: rounds before them.
        clock: s.

    Returns:
        Times by key, in the order of the candidates.
    """
    found = {candidate.key: Times() for candidate in candidates}
    for number in range(warm_up + count):
        work = next(rounds)
        first = number % len(candidates)
        for candidate in (*candidates[first:], *candidates[:first]):
            start = clock()
            answer = candidate.run(work)
            spent = 1e3 * (clock() - start)
            counts = candidate.settle is None or candidate.settle(work, answer)
            if number >= warm_up:
                times = found[candidate.key]
                times.rounds += 1
                if counts:
                    times.milliseconds.append(spent)
    return found


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep this process to one thread on one core, as far as the system lets us."""
    in_opencv, in_numba = cv2.getNumThreads(), numba.get_num_threads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
        numba.set_num_threads(in_numba)
        cv2.setNumThreads(in_opencv)
