"""Time that has passed, on a clock that may be simulated, stop or go back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from pipeline_tracker.geometry.pose_buffer import SECOND_NS

# A clock that shows the same time for so long has stopped: simulators and bag players publish it
# some ten times a second or more.
STANDSTILL = 0.5


@dataclass(frozen=True)
class Mark:
    """A moment, on the node's clock in ns and on the steady clock in s."""

    now_ns: int
    steady: float


class LiveClock:
    """Measures time on the node's clock; while that stands still, on the steady clock.

    So a wait is that of simulated time, however fast it runs, and ends all the same when the
    simulation or the bag has ended.
    """

    def __init__(
        self, now_ns: Callable[[], int], steady: Callable[[], float] = time.monotonic
    ) -> None:
        """Start to watch a clock.

        Args:
            now_ns: the node's clock, ns.
            steady: a clock that never stops nor goes back, s.
        """
        self._now_ns = now_ns
        self._steady = steady
        self._shown = now_ns()
        self._moved = steady()

    def now_ns(self) -> int:
        """Return the time on the node's clock, ns."""
        shown = self._now_ns()
        if shown != self._shown:
            self._shown, self._moved = shown, self._steady()
        return shown

    def mark(self) -> Mark:
        """Return this moment."""
        return Mark(self.now_ns(), self._steady())

    def since(self, mark: Mark) -> float:
        """Return the time since a moment, s; to be asked some ten times a second.

        It is negative where the clock has gone back behind the moment.
        """
        passed = (self.now_ns() - mark.now_ns) / SECOND_NS
        still = min(self._steady() - self._moved, self._steady() - mark.steady)
        return passed + still if still >= STANDSTILL else passed
