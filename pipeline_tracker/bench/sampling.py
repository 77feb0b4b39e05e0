"""Where the time goes: samples of the call stack while a pair is processed again and again."""

from __future__ import annotations

import linecache
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import pipeline_tracker
from pipeline_tracker.bench.options import Size
from pipeline_tracker.bench.schema import Share, Shares
from pipeline_tracker.pipeline import Pipeline

Stack = tuple[str, ...]

_PERIOD = 0.001
_PACKAGE = str(Path(pipeline_tracker.__file__).parent)
_ROOT = Pipeline.process.__code__
_LONGEST_LINE = 48
_LEAST_SHARE = 0.01
# From the pair down: more is for the flame graph.
_DEPTH = 3


@dataclass(frozen=True)
class Profile:
    """Samples of the stack.

    Attributes:
        stacks: how often each was met: functions of ours that a pair calls, outermost first, and
            at the end the line of code at work there.
        pairs: pairs processed meanwhile.
    """

    stacks: Counter[Stack]
    pairs: int

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(self.stacks.values())

    def shares(self, size: Size) -> Shares:
        """Return the functions that take 1 % or more, without the lines; images of ``size``."""
        total = max(self.samples, 1)
        below: Counter[Stack] = Counter()
        for stack, times in self.stacks.items():
            for depth in range(1, min(len(stack) - 1, _DEPTH + 1) + 1):
                below[stack[:depth]] += times
        steps: list[Share] = []

        def visit(parent: Stack) -> None:
            inside = [p for p in below if p[:-1] == parent and below[p] >= _LEAST_SHARE * total]
            for path in sorted(inside, key=lambda p: -below[p]):
                steps.append(Share(path=list(path), share=below[path] / total))
                visit(path)

        visit(())
        width, height = size
        return Shares(
            width=width, height=height, samples=self.samples, pairs=self.pairs, steps=steps
        )


def sample(work: Callable[[], object], seconds: float) -> Profile:
    """Call something for a time, and look a thousand times a second at where it is.

    Args:
        work: processes one pair, in this thread.
        seconds: how long, s.
    """
    watched = threading.get_ident()
    stacks: Counter[Stack] = Counter()
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_PERIOD):
            frame = sys._current_frames().get(watched)  # noqa: SLF001 - there is no other way
            stack = _stack(frame)
            if stack:
                stacks[stack] += 1

    watcher = threading.Thread(target=watch, name="sampling", daemon=True)
    interval = sys.getswitchinterval()
    # Python code is interrupted soon, so that it is not met less often than compiled code.
    sys.setswitchinterval(1e-4)
    pairs = 0
    watcher.start()
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            work()
            pairs += 1
    finally:
        ended.set()
        watcher.join()
        sys.setswitchinterval(interval)
    return Profile(stacks, pairs)


def _stack(frame: FrameType | None) -> Stack:
    """Return the functions of ours that a pair called, outermost first, and the innermost's line.

    Empty outside of a pair, and in ``Pipeline.process`` itself.
    """
    found: list[str] = []
    while frame is not None:
        code = frame.f_code
        if code is _ROOT:
            return tuple(reversed(found))
        if code.co_filename.startswith(_PACKAGE):
            if not found:
                line = linecache.getline(code.co_filename, frame.f_lineno).strip()
                found.append(line if len(line) <= _LONGEST_LINE else f"{line[:_LONGEST_LINE]}…")
            found.append(getattr(code, "co_qualname", code.co_name))
        frame = frame.f_back
    return ()
