"""5.3.1 while running: how much time a frame may take, and how much it takes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from statistics import median

from pipeline_tracker.diagnostics.levels import Level
from pipeline_tracker.diagnostics.windows import Percentiles

# Frames that the margin is judged by.
FRAMES = 5


class Margin:
    """The condition t1 <= t2, and the overlap of neighbouring images."""

    def __init__(self, least_overlap: float) -> None:
        """Start without a frame.

        Args:
            least_overlap: setting ``motion.min_overlap``, 0 to 1.
        """
        self._least = least_overlap
        self._overlaps: deque[float] = deque(maxlen=FRAMES)
        self._allowed: deque[float] = deque(maxlen=FRAMES)
        self._used = Percentiles()

    def see(self, overlap: float | None, allowed: float | None, used: float) -> None:
        """Take in a frame.

        Args:
            overlap: share of the pipe in view that the frame before showed too; None: not known.
            allowed: t2, the time that a frame may take at this speed, s; None: not known.
            used: t1, the time that it took, s.
        """
        self._used.add(used)
        if overlap is not None:
            self._overlaps.append(overlap)
        if allowed is not None:
            self._allowed.append(allowed)

    def tell(self, note: Callable[[str, str, Level, str], None]) -> None:
        """Put what is known into a report; see ``Health.note``."""
        used = self._used.of(95.0)
        if used:
            note("5.3.1: time used t1, 95 % [ms]", f"{1e3 * used[0]:.0f}", Level.OK, "")
        if self._overlaps:
            overlap = median(self._overlaps)
            short = overlap < self._least
            words = f"images overlap by {overlap:.2f}, least {self._least:g} (5.3.1)"
            note("5.3.1: overlap", f"{overlap:.2f}", Level(short), words)
        if self._allowed and used:
            allowed = median(self._allowed)
            late = used[0] > allowed
            words = f"a frame takes {1e3 * used[0]:.0f} ms of {1e3 * allowed:.0f} ms (5.3.1)"
            shown = f"{1e3 * allowed:.0f}" if allowed < 1e4 else "more than 10000"
            note("5.3.1: time available t2 [ms]", shown, Level(late), words)
