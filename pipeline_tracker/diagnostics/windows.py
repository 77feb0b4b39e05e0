"""Rates and percentiles over the last while, in bounded memory."""

from __future__ import annotations

import threading
from collections import deque
from itertools import pairwise
from statistics import median

import numpy as np

# Arrivals that a rate is taken from, and times that percentiles are taken from.
ARRIVALS = 50
TIMES = 300


class Rate:
    """How often something comes."""

    def __init__(self) -> None:
        """Start without an arrival."""
        self._times: deque[float] = deque(maxlen=ARRIVALS)

    def add(self, now: float) -> None:
        """Take in an arrival at ``now``, s of a steady clock."""
        self._times.append(now)

    @property
    def last(self) -> float | None:
        """Time of the last arrival, s; None before the first."""
        return self._times[-1] if self._times else None

    @property
    def period(self) -> float | None:
        """Median time between two arrivals, s; None before the second."""
        gaps = [after - before for before, after in pairwise(self._times)]
        return median(gaps) if gaps else None

    def hertz(self, now: float) -> float:
        """Return the rate of the arrivals held, 1/s; it falls while nothing comes."""
        if len(self._times) < 2:
            return 0.0
        silence = now - self._times[-1]
        spans = len(self._times) - 1
        span = self._times[-1] - self._times[0]
        # Within the usual gap silence says nothing yet.
        over = max(0.0, silence - span / spans)
        return spans / max(span + over, 1e-9)


class Percentiles:
    """How long something takes; entered from any thread."""

    def __init__(self) -> None:
        """Start without a time."""
        self._lock = threading.Lock()
        self._times: deque[float] = deque(maxlen=TIMES)

    def add(self, seconds: float) -> None:
        """Take in a time, s."""
        with self._lock:
            self._times.append(seconds)

    def clear(self) -> None:
        """Forget all times."""
        with self._lock:
            self._times.clear()

    def of(self, *shares: float) -> tuple[float, ...]:
        """Return percentiles, s; empty before the first time.

        Args:
            shares: which ones, 0 to 100.
        """
        with self._lock:
            times = list(self._times)
        return tuple(float(v) for v in np.percentile(times, shares)) if times else ()
