"""The account of what a node is given: received = processed + dropped + still waiting."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Account:
    """An account at one moment.

    Attributes:
        received: how many have come.
        processed: how many have been answered.
        dropped: how many have not, by reason.
    """

    received: int
    processed: int
    dropped: Mapping[str, int]

    @property
    def lost(self) -> int:
        """How many were dropped, for all reasons."""
        return sum(self.dropped.values())

    @property
    def waiting(self) -> int:
        """How many are held and under way."""
        return self.received - self.processed - self.lost


class Ledger:
    """Counts from several threads: every item once when it comes, and once when it goes."""

    def __init__(self) -> None:
        """Start with nothing."""
        self._lock = threading.Lock()
        self._received = 0
        self._processed = 0
        self._dropped: Counter[str] = Counter()

    def received(self, count: int = 1) -> None:
        """Enter what has come."""
        with self._lock:
            self._received += count

    def processed(self, count: int = 1) -> None:
        """Enter what has been answered."""
        with self._lock:
            self._processed += count

    def dropped(self, reason: str, count: int = 1) -> None:
        """Enter what is given up, and why."""
        with self._lock:
            self._dropped[reason] += count

    def account(self) -> Account:
        """Return the account of this moment."""
        with self._lock:
            return Account(self._received, self._processed, dict(self._dropped))
