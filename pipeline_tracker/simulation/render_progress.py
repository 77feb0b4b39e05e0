"""How far a simulation is: a bar on a terminal, and what it took in the end."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from typing_extensions import Self


class RenderProgress:
    """Tells pairs done and time left; a context manager. At its end one line with the speed."""

    def __init__(
        self, total: int, stream: TextIO | None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start to count.

        Args:
            total: number of pairs.
            stream: where to write, no bar where it is no terminal; None: nowhere.
            clock: seconds that never go back.
        """
        self._total, self._stream, self._clock = total, stream, clock
        self._done = 0
        self._start = clock()
        self._bar = Progress(
            TextColumn("rendering"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("pairs"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(file=stream),
            disable=stream is None or not stream.isatty(),
            transient=True,
        )
        self._task = self._bar.add_task("", total=total)

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Take the bar away; tell the speed, if all is done."""
        self._bar.stop()
        if self._stream is not None and self._done == self._total:
            seconds = self._clock() - self._start
            # Whoever read the line may be gone; the bag is whole all the same.
            with suppress(BrokenPipeError):
                self._stream.write(f"{speed_line(self._total, seconds)}\n")
                self._stream.flush()

    def advance(self) -> None:
        """Count one more pair."""
        self._done += 1
        self._bar.advance(self._task)


def speed_line(pairs: int, seconds: float) -> str:
    """Return what a number of pairs took: ``20 pairs in 41 s, 2.1 s a pair``."""
    noun = "pair" if pairs == 1 else "pairs"
    return f"{pairs} {noun} in {seconds:.0f} s, {seconds / pairs:.1f} s a pair"
