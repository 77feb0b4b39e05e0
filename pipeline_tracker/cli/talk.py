"""How much a command tells: -q and -v."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console

    from pipeline_tracker.settings import Settings


@dataclass(frozen=True)
class Talk:
    """What a command may say.

    What is asked for in so many words (``--json``, ``--list``, ``--schema``) is no talk, and is
    printed in any case. Errors are too.

    Attributes:
        quiet: no progress, no summary.
        verbose: settings in force and times too, on standard error.
    """

    quiet: bool = False
    verbose: bool = False

    def say(self, text: str) -> None:
        """Say how it went, on standard output."""
        if not self.quiet:
            hand_over(text)

    def detail(self, text: str) -> None:
        """Say more, for -v alone, on standard error."""
        if self.verbose:
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def settings(self, settings: Settings) -> None:
        """Say which settings are in force, for -v alone."""
        if self.verbose:
            from pipeline_tracker.settings_io import dump_settings

            self.detail(dump_settings(settings, "settings in force").rstrip("\n"))

    @property
    def stream(self) -> TextIO:
        """Where progress is told."""
        return _Nowhere() if self.quiet else sys.stdout

    def console(self, **options: Any) -> Console:
        """Return a console that prints nothing where the command is to be quiet.

        Args:
            options: of rich's console. It has colours on a terminal alone, and not where NO_COLOR
                is set.
        """
        from rich.console import Console

        return Console(quiet=self.quiet, **options)

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Say what something took, for -v alone."""
        wall, cpu = time.monotonic(), time.process_time()
        yield
        wall, cpu = time.monotonic() - wall, time.process_time() - cpu
        self.detail(f"took {wall:.1f} s, {cpu:.1f} s of them CPU time of this process")


def hand_over(text: str) -> None:
    """Print what was asked for."""
    sys.stdout.write(f"{text}\n")


class _Nowhere(io.StringIO):
    """A stream that is no terminal and keeps nothing."""

    def write(self, text: str, /) -> int:
        """Take a text, and leave it."""
        return len(text)
