"""One line of the doctor's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "look", "wrong"]


@dataclass(frozen=True)
class Finding:
    """What was looked at and what was seen.

    Attributes:
        level: ok; look: works, but not as well as it could, or not everything; wrong: something
            that was asked for cannot work.
        what: the thing, in a word or two.
        seen: what was found.
        advice: what to do; empty where nothing is to be done.
    """

    level: Level
    what: str
    seen: str
    advice: str = ""

    def as_json(self) -> dict[str, str]:
        """Return the finding as plain values."""
        return {"level": self.level, "what": self.what, "seen": self.seen, "advice": self.advice}


Examination = Callable[[], Iterator[Finding]]


def examined(examination: Examination, what: str) -> Iterator[Finding]:
    """Yield the findings of one examination; one that fails is a finding too.

    Args:
        examination: yields findings.
        what: its subject, for the case that it fails.
    """
    try:
        yield from examination()
    except Exception as error:  # noqa: BLE001 - a doctor that dies helps nobody
        seen = f"could not be looked at ({type(error).__name__}: {' '.join(str(error).split())})"
        yield Finding("look", what, seen, "Report it, with this line")
