"""Measurements of one thing, frame after frame, until it is sure that they are off."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_KEPT = 40
# Standard error of a median over its mean absolute deviation times the root of the count.
_MEDIAN_ERROR = 1.2533 * 1.4826
_ERRORS = 3.0


class Series:
    """The last measurements of one thing, each a number or a vector."""

    def __init__(self, right: float, slack: float, least: int, spread: float) -> None:
        """Start without measurements.

        Args:
            right: what all is well at; for a vector each of its numbers.
            slack: up to so far from it nothing is said, however sure it is.
            least: measurements that are needed.
            spread: measurements that scatter more than this, and than a tenth of what they are off,
                tell nothing (median deviation).
        """
        self._right = right
        self._slack = slack
        self._least = least
        self._spread = spread
        self._values: deque[Array] = deque(maxlen=_KEPT)
        self._off: bool | None = None

    def __len__(self) -> int:
        """How many are kept."""
        return len(self._values)

    def add(self, value: float | Array) -> None:
        """Take in a measurement."""
        self._off = None
        self._values.append(np.atleast_1d(np.asarray(value, np.float64)))

    @property
    def enough(self) -> bool:
        """Whether there are enough to tell anything."""
        return len(self._values) >= self._least

    @property
    def median(self) -> Array:
        """The median of each number, (K,); there is at least one measurement."""
        return np.asarray(np.median(np.array(self._values), axis=0), np.float64)

    def surely_off(self) -> bool:
        """Tell whether the median is off by more than the slack, and not by chance."""
        # Asked with each frame, and most frames add nothing.
        if self._off is None:
            self._off = self.enough and self._is_off()
        return self._off

    def _is_off(self) -> bool:
        median = self.median
        deviation = np.median(np.abs(np.array(self._values) - median), axis=0)
        off = float(np.linalg.norm(median - self._right))
        if float(deviation.max()) > max(self._spread, 0.1 * off):
            return False
        error = _MEDIAN_ERROR * float(np.linalg.norm(deviation)) / np.sqrt(len(self._values))
        return bool(off > self._slack + _ERRORS * error)
