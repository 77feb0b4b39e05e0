"""The part of a rectified picture that its camera has not seen."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Mask = NDArray[np.bool_]


class Unseen:
    """Pixels of a rectified picture whose direction lies outside the camera's own picture.

    What is there instead is made up, and must give neither edges nor matches.
    """

    def __init__(self, mask: Mask) -> None:
        """Keep the mask, (H, W) bool; true where the camera has not seen."""
        self.mask = mask
        self._grown: dict[tuple[int, int], Mask] = {}

    def grown(self, factor: int, margin: int) -> Mask:
        """Return the mask of a picture shrunk by a whole factor, and grown by a margin.

        Kept for the next picture: there are as many as levels of a pyramid.

        Args:
            factor: rows and columns left over are dropped, as ``shrink`` does.
            margin: px of the shrunk picture.

        Returns:
            (H // factor, W // factor) bool.
        """
        key = factor, margin
        if key not in self._grown:
            height, width = (side // factor for side in self.mask.shape)
            blocks = self.mask[: height * factor, : width * factor]
            small = blocks.reshape(height, factor, width, factor).any(axis=(1, 3))
            kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
            grown = cv2.dilate(np.asarray(small, np.uint8), kernel)
            self._grown[key] = np.asarray(grown, np.bool_)
        return self._grown[key]

    def near(self, points: ArrayLike, factor: int, margin: int) -> Mask:
        """Tell which points are unseen or near it.

        Args:
            points: (N, 2) px of the shrunk picture.
            factor, margin: see ``grown``.

        Returns:
            (N,) bool.
        """
        mask = self.grown(factor, margin)
        cells = np.rint(np.asarray(points, np.float64)).astype(np.int64)
        columns = np.clip(cells[:, 0], 0, mask.shape[1] - 1)
        rows = np.clip(cells[:, 1], 0, mask.shape[0] - 1)
        found: Mask = mask[rows, columns]
        return found


class UnseenPair(NamedTuple):
    """Of both pictures of a pair; None where the camera has seen all of it."""

    left: Unseen | None = None
    right: Unseen | None = None


SEEN_WHOLE = UnseenPair()
