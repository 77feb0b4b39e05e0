"""How one node is."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator

from pipeline_tracker.diagnostics.inputs import InputWatch, Need
from pipeline_tracker.diagnostics.ledger import Account, Ledger
from pipeline_tracker.diagnostics.levels import Finding, Level, Report, report
from pipeline_tracker.diagnostics.windows import Percentiles

# Drops and losses count for so long, in reports of one a second.
REMEMBERED = 10

UNCONFIGURED, INACTIVE, ACTIVE = "unconfigured", "inactive", "active"


class Health:
    """What is known of a node, and the rule that makes a level of it.

    ``ledger``, ``latency`` and ``unused`` may be filled by any thread, the rest by one.

    Attributes:
        ledger: the node's frames (images, requests, whatever it answers).
        latency: from the image's stamp to the node's answer, s.
    """

    def __init__(
        self, name: str, items: str = "frames", steady: Callable[[], float] = time.monotonic
    ) -> None:
        """Start as a node that is not configured.

        Args:
            name: of the node.
            items: what its ledger counts, in a word.
            steady: a clock that never goes back, s.
        """
        self.name = name
        self.ledger = Ledger()
        self.latency = Percentiles()
        self._items = items
        self._steady = steady
        self._lock = threading.Lock()
        self._unused: Counter[str] = Counter()
        self._state, self._cause = UNCONFIGURED, ""
        self._inputs: dict[str, InputWatch] = {}
        self._mismatches: dict[str, str] = {}
        self._notes: dict[str, tuple[str, Finding | None]] = {}
        self._past: deque[tuple[Account, int]] = deque(maxlen=REMEMBERED)

    def became(self, state: str, cause: str = "") -> None:
        """Take notice of another state of the node's life.

        Args:
            state: UNCONFIGURED, INACTIVE or ACTIVE.
            cause: why it is not further, where something failed.
        """
        self._state, self._cause = state, cause
        # What was before says nothing about the time to come.
        self._inputs.clear()
        self._notes.clear()
        self._past.clear()
        self._past.append((self.ledger.account(), 0))
        self.latency.clear()

    def watch(self, topic: str, need: Need, timeout: float = 0.0) -> InputWatch:
        """Return what watches an input from now on; see ``InputWatch``."""
        return self._inputs.setdefault(topic, InputWatch(topic, need, timeout, self._steady()))

    def forget(self, topic: str) -> None:
        """Watch an input no longer."""
        self._inputs.pop(topic, None)

    def heard(self, watch: InputWatch, age: float | None) -> None:
        """Take in a message of an input; ``age``: time since its stamp, s."""
        watch.heard(self._steady(), age)

    def unused(self, reason: str, count: int = 1) -> int:
        """Count an input that is not used; return how many there were for that reason."""
        with self._lock:
            self._unused[reason] += count
            return self._unused[reason]

    @property
    def mismatches(self) -> list[str]:
        """The topics with ends that cannot be joined."""
        return list(self._mismatches)

    def mismatched(self, topic: str, words: str) -> None:
        """Take notice of ends of a topic that cannot be joined; no words: they can again."""
        self._mismatches.pop(topic, None)
        if words:
            self._mismatches[topic] = words

    def note(self, key: str, value: str, level: Level = Level.OK, words: str = "") -> None:
        """Set a value of the report, and what is amiss about it.

        Args:
            key: name of the value.
            value: the value in words.
            level: how bad it is.
            words: what is amiss; needed where the level is not OK.
        """
        self._notes[key] = value, Finding(level, words) if level is not Level.OK else None

    def report(self) -> Report:
        """Return the node's status; to be asked once a second."""
        now = self._steady()
        account, lost = self.ledger.account(), sum(w.lost for w in self._inputs.values())
        self._past.append((account, lost))
        return report(self.name, self._findings(now, account, lost), self._values(now, account))

    def _findings(self, now: float, account: Account, lost: int) -> Iterator[Finding]:
        if self._state != ACTIVE:
            level = Level.ERROR if self._cause else Level.WARN
            yield Finding(level, f"{self._state}: {self._cause}" if self._cause else self._state)
            return
        for watch in self._inputs.values():
            finding = watch.finding(now)
            if finding is not None:
                yield finding
        yield from self._drops(account, lost)
        for words in self._mismatches.values():
            yield Finding(Level.WARN, words)
        for _, finding in self._notes.values():
            if finding is not None:
                yield finding

    def _drops(self, account: Account, lost: int) -> Iterator[Finding]:
        before, lost_before = self._past[0]
        dropped = account.lost - before.lost
        while_it = f"in the last {len(self._past) - 1} s"
        if dropped > 0:
            reasons = {
                reason: count - before.dropped.get(reason, 0)
                for reason, count in account.dropped.items()
            }
            most = max(reasons, key=lambda reason: reasons[reason])
            done = account.processed - before.processed
            level = Level.WARN if done else Level.ERROR
            of = f"{dropped} of {dropped + done}" if done else f"all {dropped}"
            yield Finding(level, f"{of} {self._items} dropped {while_it}, most: {most}")
        if lost > lost_before:
            count = lost - lost_before
            yield Finding(Level.WARN, f"{count} messages sent but not received {while_it}")

    def _values(self, now: float, account: Account) -> Iterator[tuple[str, str]]:
        yield "state", self._state
        yield f"{self._items} received", str(account.received)
        yield f"{self._items} processed", str(account.processed)
        yield f"{self._items} waiting", str(account.waiting)
        yield f"{self._items} dropped", str(account.lost)
        for reason, count in sorted(account.dropped.items()):
            yield f"{self._items} dropped: {reason}", str(count)
        with self._lock:
            unused = dict(self._unused)
        for reason, count in sorted(unused.items()):
            yield f"not used: {reason}", str(count)
        shares = self.latency.of(50.0, 95.0, 100.0)
        for name, seconds in zip(("median", "95 %", "most"), shares, strict=False):
            yield f"latency, {name} [ms]", f"{1e3 * seconds:.0f}"
        for watch in self._inputs.values():
            yield from watch.values(now)
        for topic, words in self._mismatches.items():
            yield f"{topic}: quality of service", words
        for key, (value, _) in self._notes.items():
            yield key, value
