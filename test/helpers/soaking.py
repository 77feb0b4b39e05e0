"""What the long runs of ``test/soak`` share: bounded attempts, and words about them."""

from __future__ import annotations

import resource
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

LONGEST_WORDS = 1000


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def say_counts(outcomes: Counter[str]) -> None:
    for outcome, count in sorted(outcomes.items()):
        say(f"{outcome} {count}")


def memory_mib() -> float:
    """The most memory that the process has ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextmanager
def bounded(seconds: int, again: str) -> Iterator[None]:
    """End the program where something takes longer, or raises; say how to repeat it."""

    def hung(_number: int, _frame: FrameType | None) -> None:
        message = f"still busy after {seconds} s"
        raise SystemExit(message)

    signal.signal(signal.SIGALRM, hung)
    signal.alarm(seconds)
    try:
        yield
    except BaseException:
        say(f"again: {again}")
        raise
    finally:
        signal.alarm(0)


def attempt(task: Callable[[], object], expected: type[Exception]) -> str:
    """Do something; return "done", or "refused" where it raised the error that it may raise."""
    try:
        task()
    except expected as error:
        text = str(error)
    else:
        return "done"
    assert text
    assert "\n" not in text
    assert len(text) < LONGEST_WORDS, text
    return "refused"
