"""One level over all nodes, for an operator to alarm on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from pipeline_tracker.diagnostics.levels import Finding, Level, Report, report

# A node that is silent for so long, s, is not there any more.
SILENT = 3.0


class Overall:
    """Listens to the reports of all nodes, its own among them, and to what is published."""

    def __init__(
        self, name: str, nodes: Sequence[str], steady: Callable[[], float] = time.monotonic
    ) -> None:
        """Start to listen.

        Args:
            name: of the overall report.
            nodes: names of the reports that must come.
            steady: a clock that never goes back, s.
        """
        self._name = name
        self._steady = steady
        self._since = steady()
        self._heard: dict[str, tuple[float, Level, str]] = {}
        self._nodes = tuple(nodes)
        self._valid: float | None = None

    def hear(self, name: str, level: int, message: str) -> None:
        """Take in a report; those of others are not heeded."""
        if name in self._nodes:
            self._heard[name] = self._steady(), Level(min(max(level, 0), 3)), message

    def published(self, *, valid: bool) -> None:
        """Take notice of a relative state."""
        if valid:
            self._valid = self._steady()

    def report(self) -> Report:
        """Return the overall status; to be asked once a second."""
        now = self._steady()
        return report(self._name, self._findings(now), self._values(now))

    def _findings(self, now: float) -> Iterator[Finding]:
        for node in self._nodes:
            if self._is_silent(node, now):
                # Right after the start the others have had no time to speak.
                early = now - self._since <= SILENT
                yield Finding(Level.WARN if early else Level.ERROR, f"{node} is silent")
            else:
                _, level, message = self._heard[node]
                if level is not Level.OK:
                    yield Finding(level, f"{node}: {message}")

    def _values(self, now: float) -> Iterator[tuple[str, str]]:
        for node in self._nodes:
            silent = self._is_silent(node, now)
            yield node, "SILENT" if silent else self._heard[node][1].name
        ago = "never" if self._valid is None else f"{now - self._valid:.1f}"
        yield "last valid relative state ago [s]", ago

    def _is_silent(self, node: str, now: float) -> bool:
        return node not in self._heard or now - self._heard[node][0] > SILENT
