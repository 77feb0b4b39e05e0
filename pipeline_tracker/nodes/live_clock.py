"""Time that has passed, on a clock that may be simulated, stop or go back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from pipeline_tracker.geometry.pose_buffer import SECOND_NS

# A clock that shows the same time for so long has stopped: simulators and bag players publish it
# some ten times a second or more.
STANDSTILL = 0.5
# The pace of the clock is measured over so long, s.
_PACE_OVER = 1.0


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
        self._paced = Mark(self._shown, self._moved)
        self._pace = 1.0

    def now_ns(self) -> int:
        """Return the time on the node's clock, ns."""
        shown = self._now_ns()
        if shown != self._shown:
            self._shown, self._moved = shown, self._steady()
            self._measure_pace()
        return shown

    @property
    def runs(self) -> bool:
        """Whether the clock had begun, and had not stopped, when it was last looked at."""
        return self._shown > 0 and self._steady() - self._moved < STANDSTILL

    @property
    def pace(self) -> float:
        """Seconds of the clock in a second, in the last while; at least 1."""
        return self._pace

    def _measure_pace(self) -> None:
        way = (self._shown - self._paced.now_ns) / SECOND_NS
        passed = self._moved - self._paced.steady
        begun = self._paced.now_ns > 0
        if begun and way >= 0.0 and passed < _PACE_OVER:
            return
        self._pace = max(1.0, way / passed) if begun and way >= 0.0 else 1.0
        self._paced = Mark(self._shown, self._moved)

    def mark(self) -> Mark:
        """Return this moment."""
        return Mark(self.now_ns(), self._steady())

    def since(self, mark: Mark, standstill: float = STANDSTILL) -> float:
        """Return the time since a moment, s; to be asked some ten times a second.

        It is negative where the clock has gone back behind the moment.

        Args:
            mark: the moment.
            standstill: a clock that shows the same time for so long has stopped, s.
        """
        passed = (self.now_ns() - mark.now_ns) / SECOND_NS
        still = min(self._steady() - self._moved, self._steady() - mark.steady)
        return passed + still if still >= standstill else passed
