"""Levels, findings and reports, as diagnostic_msgs/DiagnosticStatus has them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum


class Level(IntEnum):
    """How bad it is; the numbers are those of DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Finding:
    """Something that is amiss."""

    level: Level
    words: str


@dataclass(frozen=True)
class Report:
    """One DiagnosticStatus.

    Attributes:
        name: ``node: task``, as the tools expect it.
        level: the worst finding's.
        message: the findings, the worst first; "ok" where there is none.
        values: names and values.
    """

    name: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...] = ()


def report(name: str, findings: Iterable[Finding], values: Iterable[tuple[str, str]]) -> Report:
    """Put findings and values together."""
    worst_first = sorted(findings, key=lambda finding: -finding.level)
    level = worst_first[0].level if worst_first else Level.OK
    message = "; ".join(finding.words for finding in worst_first) or "ok"
    return Report(name, level, message, tuple(values))
