"""Keeps the account of a flow under test."""

from __future__ import annotations

from pipeline_tracker.diagnostics.ledger import Ledger


class Bookkeeper:
    """A ``Clerk``: what was dropped, in order, and the account."""

    def __init__(self) -> None:
        self.drops: list[str] = []
        self.ledger = Ledger()

    def dropped(self, reason: str, details: str = "", items: int = 0) -> None:
        assert details
        self.drops.append(reason)
        if items:
            self.ledger.dropped(reason, items)

    def answered(self, stamp: int) -> None:
        assert stamp
        self.ledger.processed()
