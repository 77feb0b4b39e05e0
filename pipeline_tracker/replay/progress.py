"""How far a replay is: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from typing_extensions import Self

# Plain lines come that often, s.
_PLAIN_EVERY = 5.0


class ReplayProgress:
    """Tells frames done, frames per second and time left; a context manager."""

    def __init__(
        self, total: int, stream: TextIO, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start to count.

        Args:
            total: number of frames expected.
            stream: where to write.
            clock: seconds that never go back.
        """
        self._total = total
        self._stream = stream
        self._clock = clock
        self._done = 0
        self._start = self._told = clock()
        self._bar: Progress | None = None
        if stream.isatty():
            self._bar = Progress(
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                console=Console(file=stream),
                transient=True,
            )
            self._task = self._bar.add_task("replay", total=total, rate="")

    def __enter__(self) -> Self:
        """Show the bar."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()

    def advance(self) -> None:
        """Count one more frame."""
        self._done += 1
        now = self._clock()
        rate = self._done / max(now - self._start, 1e-6)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, rate=f"{rate:.1f} frames/s")
        elif now - self._told >= _PLAIN_EVERY:
            self._told = now
            left = max(0, self._total - self._done) / rate
            # Whoever read the lines may be gone; the replay goes on.
            with suppress(BrokenPipeError):
                self._stream.write(
                    f"{self._done} of {self._total} frames, {rate:.1f} frames/s, "
                    f"{left:.0f} s left\n"
                )
                self._stream.flush()
