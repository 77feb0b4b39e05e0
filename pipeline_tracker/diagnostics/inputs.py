"""The state of one input: whether it comes, how often, and how old it is."""

from __future__ import annotations

from enum import Enum

from pipeline_tracker.diagnostics.levels import Finding, Level
from pipeline_tracker.diagnostics.windows import Rate

# After activation an input may take so long to come, s.
GRACE = 5.0
# A stamp is late, or ahead of the clock, by more than this, s.
LATE = 1.0
# An input is stale after three periods, but not before this, s.
STALE = 0.5


class Need(Enum):
    """What a node does without an input."""

    ALWAYS = "nothing"
    WANTED = "works, but less well"
    AT_TIMES = "nothing is amiss: it comes when there is cause"


class InputState(Enum):
    """What can be said of an input."""

    OK = "ok"
    NEVER = "never received"
    LATE = "late"
    AHEAD = "ahead of the clock"
    STALE = "stale"


class InputWatch:
    """Watches one topic; all calls come from one thread.

    Attributes:
        received: messages that have come.
        lost: messages that were sent and have not come.
        number: that of the last one, as its publisher counts; None where it is not known.
    """

    def __init__(self, topic: str, need: Need, timeout: float = 0.0, now: float = 0.0) -> None:
        """Start to watch.

        Args:
            topic: its name.
            need: what happens without it.
            timeout: it is stale after this time, s; 0: after three periods, at least 0.5 s.
            now: s of a steady clock.
        """
        self.topic = topic
        self.received = 0
        self.lost = 0
        self.number: int | None = None
        self._need = need
        self._timeout = timeout
        self._since = now
        self._rate = Rate()
        self._age: float | None = None

    def heard(self, now: float, age: float | None = None) -> None:
        """Take in a message.

        Args:
            now: s of a steady clock.
            age: time since its stamp, by the node's clock, s; None where it has no stamp.
        """
        self.received += 1
        self._rate.add(now)
        self._age = age

    def state(self, now: float) -> InputState:
        """Return what can be said of the input at a time of the steady clock, s."""
        last = self._rate.last
        if last is None:
            return InputState.NEVER
        if self._need is not Need.AT_TIMES and now - last > self._stale_after:
            return InputState.STALE
        if self._age is not None and self._age > LATE:
            return InputState.LATE
        if self._age is not None and self._age < -LATE:
            return InputState.AHEAD
        return InputState.OK

    def finding(self, now: float) -> Finding | None:
        """Return what is amiss with the input; None where nothing is."""
        state = self.state(now)
        if state is InputState.OK or (state is InputState.NEVER and self._need is Need.AT_TIMES):
            return None
        words = f"{self.topic} {state.value}"
        if state is InputState.NEVER:
            early = now - self._since <= GRACE
            level = Level.ERROR if self._need is Need.ALWAYS and not early else Level.WARN
            return Finding(level, f"waiting for {self.topic}" if early else words)
        if state is InputState.STALE:
            level = Level.ERROR if self._need is Need.ALWAYS else Level.WARN
            return Finding(level, f"{words} for {self._silence(now):.1f} s")
        age = abs(self._age or 0.0)
        return Finding(Level.WARN, f"{words} by {_seconds(age)} (use_sim_time?)")

    def values(self, now: float) -> list[tuple[str, str]]:
        """Return what is known of the input, by name."""
        topic = self.topic
        values = [
            (f"{topic}: state", self.state(now).value),
            (f"{topic}: received", str(self.received)),
            (f"{topic}: sent but not received", str(self.lost)),
        ]
        if self._rate.last is not None:
            values.append((f"{topic}: rate [Hz]", f"{self._rate.hertz(now):.2f}"))
            values.append((f"{topic}: last one ago [s]", f"{self._silence(now):.2f}"))
        if self._age is not None:
            values.append((f"{topic}: age of its stamp [s]", f"{self._age:.3f}"))
        return values

    @property
    def _stale_after(self) -> float:
        if self._timeout > 0.0:
            return self._timeout
        return max(STALE, 3.0 * (self._rate.period or 0.0))

    def _silence(self, now: float) -> float:
        return now - (self._rate.last or now)


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 1000.0 else "more than 1000 s"
