"""What stamps tell: time goes on, has gone back, or the stamp is wrong."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum

from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.nodes.live_clock import LiveClock

_CLOCK = "clock"
# A stamp further ahead of the clock than this is wrong, s: clocks of one vehicle agree better.
AHEAD = 1.0
# An input that was ever so near to the node's clock goes by it, s; others are played from a bag.
_NEAR = 60.0


class Step(Enum):
    """What a stamp tells about the time."""

    FORWARD = "forward"
    BACKWARD = "backward"
    PAST = "of_the_past"
    UNSET = "without_stamp"
    FUTURE = "of_the_future"
    STALE = "stale"


class StampJudge:
    """Judges stamps by the node's clock, as far as they are of that clock.

    Inputs that never came near the clock, such as a bag that is played without /clock, are not
    judged; nor is any while a simulated clock stands still. Times are those of a clock that runs at
    the pace of the steady one; where a simulation runs faster, there is more of them.
    """

    def __init__(self, clock: LiveClock, max_age: float | None = None) -> None:
        """Start without inputs.

        Args:
            clock: the node's time.
            max_age: a stamp that is older is stale, s; None: no age is.
        """
        self._clock = clock
        self.max_age = max_age
        self._of_clock: set[str] = set()

    def age(self, kind: str, stamp_ns: int) -> float | None:
        """Return the age of a stamp, s, below 0 in the future; None where it cannot be judged."""
        age = (self._clock.now_ns() - stamp_ns) / SECOND_NS
        if not self._clock.runs:
            return None
        if abs(age) <= _NEAR:
            self._of_clock.add(kind)
        return age if kind in self._of_clock else None

    def fault(self, kind: str, stamp_ns: int, newest_ns: int | None) -> Step | None:
        """Return what is wrong with a stamp, or None.

        Args:
            kind: which input it came by.
            stamp_ns: stamp, ns.
            newest_ns: that of the input so far, ns, where this one is far behind it.
        """
        age = self.age(kind, stamp_ns)
        if age is None:
            return None
        pace = self._clock.pace
        if -age > AHEAD * pace:
            return Step.FUTURE
        # Time has not gone back: by the clock the newest stamp was right.
        if newest_ns is not None and age + (stamp_ns - newest_ns) / SECOND_NS >= -AHEAD * pace:
            return Step.STALE
        return Step.STALE if self.max_age is not None and age > self.max_age * pace else None


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
        judge: StampJudge | None = None,
        jump: float = 1.0,
        patience: float = 5.0,
        steady: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without a past.

        Args:
            now_ns: the simulated clock, ns; None where time is not simulated.
            judge: refuses stamps by the node's clock; None: none is refused so.
            jump: a stamp that goes back by more than this is a step backward, s; by less, it is
                late.
            patience: leftovers are expected for this time after a step, s.
            steady: a clock that never goes back, s.
        """
        self._now_ns = now_ns
        self._judge = judge
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
        if stamp_ns <= 0:
            return Step.UNSET
        newest = self._newest.get(kind)
        goes_back = newest is not None and newest - stamp_ns > self._jump
        fault = self._judge and self._judge.fault(kind, stamp_ns, newest if goes_back else None)
        if fault:
            return fault
        if goes_back:
            self._step_back(kind, max(self._newest.values()), stamp_ns)
            return Step.BACKWARD
        if self._is_left_over(kind, stamp_ns):
            return Step.PAST
        self._newest[kind] = stamp_ns if newest is None else max(newest, stamp_ns)
        return Step.FORWARD

    def refusal(self, kind: str, stamp_ns: int) -> tuple[Step, str, str]:
        """Take in a stamp and put into words why its input is refused.

        Args:
            kind: which input it came by; its reason begins with this.
            stamp_ns: stamp, ns.

        Returns:
            The step, the reason (empty where the input is to be used) and its details.
        """
        step = self.see(kind, stamp_ns)
        if step in {Step.FORWARD, Step.BACKWARD}:
            return step, "", ""
        words = {
            Step.PAST: "is of before the reset",
            Step.UNSET: "is not set",
            Step.FUTURE: f"is more than {AHEAD:g} s ahead of the node's clock",
            Step.STALE: "is old, by the node's clock",
        }
        return step, f"{kind}_{step.value}", f"stamp {stamp_ns} ns {words[step]}"

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
