"""Who keeps the account of what a node is given."""

from __future__ import annotations

from typing import Protocol


class Clerk(Protocol):
    """Keeps the account; every node is one, see ``PipelineNode``."""

    def dropped(self, reason: str, details: str = "", items: int = 0) -> None:
        """Count an input that is not used, and how many items are lost with it."""

    def answered(self, stamp: int) -> None:
        """Count an item that was answered; its stamp is in ns."""
