"""Time going backward, noticed once though several inputs bring it one after another."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum

from pipeline_tracker.geometry.pose_buffer import SECOND_NS

_CLOCK = "clock"


class Step(Enum):
    """What a stamp tells about the time."""

    FORWARD = "forward"
    BACKWARD = "backward"
    PAST = "past"


class Timeline:
    """Tells of each stamp whether time goes on, has gone back, or it is left over from before.

    When a bag starts again, the clock, the poses and the images go back one after another, and
    what was under way comes in between. The first of them is the step backward. A stamp of another
    input that is nearer to the time before than to the time after that step is then a leftover,
    until that input itself goes back, or time has come halfway to where it was, or ``patience`` is
    over: a single wrong stamp must not silence the others.
    """

    def __init__(
        self,
        now_ns: Callable[[], int] | None = None,
        *,
        jump: float = 1.0,
        patience: float = 5.0,
        steady: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without a past.

        Args:
            now_ns: the simulated clock, ns; None where time is not simulated.
            jump: a stamp that goes back by more than this is a step backward, s; by less, it is
                late.
            patience: leftovers are expected for this time after a step, s.
            steady: a clock that never goes back, s.
        """
        self._now_ns = now_ns
        self._jump = round(jump * SECOND_NS)
        self._patience = patience
        self._steady = steady
        self._newest: dict[str, int] = {}
        self._boundary: int | None = None
        self._until = 0.0

    def see(self, kind: str, stamp_ns: int) -> Step:
        """Take in a stamp.

        Args:
            kind: which input it came by.
            stamp_ns: stamp, ns.
        """
        newest = self._newest.get(kind)
        if newest is not None and newest - stamp_ns > self._jump:
            self._step_back(kind, max(self._newest.values()), stamp_ns)
            return Step.BACKWARD
        if self._is_left_over(kind, stamp_ns):
            return Step.PAST
        self._newest[kind] = stamp_ns if newest is None else max(newest, stamp_ns)
        return Step.FORWARD

    def clock_went_back(self, now_ns: int, way_ns: int) -> bool:
        """Take in a backward jump of the simulated clock.

        Args:
            now_ns: time after the jump, ns.
            way_ns: how far it went back, ns, above 0.

        Returns:
            Whether this is news; False where a message has told of the same step before.
        """
        if self._boundary is not None and _CLOCK not in self._newest and now_ns <= self._boundary:
            self._newest[_CLOCK] = now_ns
            return False
        self._step_back(_CLOCK, now_ns + way_ns, now_ns)
        return True

    def _step_back(self, kind: str, before: int, after: int) -> None:
        self._newest = {kind: after}
        self._boundary = (before + after) // 2
        self._until = self._steady() + self._patience

    def _is_left_over(self, kind: str, stamp_ns: int) -> bool:
        if self._boundary is None:
            return False
        reached = max(self._newest.values())
        # Until the clock has gone back itself it shows the time before.
        if self._now_ns is not None and _CLOCK in self._newest:
            reached = max(reached, self._now_ns())
        if reached > self._boundary or self._steady() > self._until:
            self._boundary = None
            return False
        # An input that has gone back itself brings no leftovers any more.
        return kind not in self._newest and stamp_ns > self._boundary
