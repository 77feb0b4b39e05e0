"""Arrays that are used again from image to image.

A large array taken from the system anew for each image costs more than what is computed in it: its
pages are given one by one, and cleared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Workspace:
    """Arrays by name and shape. Not for several threads at once."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[str, tuple[int, ...]], NDArray[Any]] = {}
        self._size: tuple[int, ...] = ()

    def begin(self, size: tuple[int, ...]) -> None:
        """Begin with an image of a size; another size than before gives the old arrays back."""
        if size != self._size:
            self._arrays.clear()
            self._size = size

    def array(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array, its values those left in it by its last use.

        Args:
            name: what for; the same name and shape give the same array.
            shape, dtype: of the array.
        """
        found = self._arrays.get((name, shape))
        if found is None:
            found = self._arrays[name, shape] = np.empty(shape, dtype)
        return found
