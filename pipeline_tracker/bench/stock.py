"""The methods that others would take: from an image to segments, and from edges to lines."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

# As a careful user of OpenCV would set them.
_CANNY = (50, 150)
_TOLERANCE, _MIN_LENGTH = 1.2, 12.0
NO_SKELETON = "none"


@dataclass(frozen=True)
class Skeleton:
    """A skeletonization.

    Attributes:
        name: in the JSON; ``none`` where nothing is installed that has one.
        apply: edges (H, W) uint8, 0 or 255, to a skeleton of the same kind.
    """

    name: str
    apply: Callable[[Image], Image]


def find_skeleton() -> Skeleton:
    """Return OpenCV's thinning where the contrib build is installed, else that of scikit-image."""
    if hasattr(cv2, "ximgproc"):
        return Skeleton("cv2.ximgproc.thinning", cv2.ximgproc.thinning)
    if find_spec("skimage") is not None:
        skeletonize = import_module("skimage.morphology").skeletonize

        def apply(edges: Image) -> Image:
            return np.asarray(skeletonize(edges > 0), np.uint8)

        return Skeleton("skimage.morphology.skeletonize", apply)
    return Skeleton(NO_SKELETON, lambda edges: edges)


class StockMethods:
    """Images to segments, each method with its detector made once."""

    def __init__(self, skeleton: Skeleton | None = None) -> None:
        """Take a skeletonization; None: the best that is installed."""
        self.skeleton = skeleton or find_skeleton()
        self._clahe = cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
        self._lsd = cv2.createLineSegmentDetector()
        ximgproc = getattr(cv2, "ximgproc", None)
        self._edge_drawing = ximgproc.createEdgeDrawing() if ximgproc is not None else None

    @property
    def has_edlines(self) -> bool:
        """Whether this OpenCV has EDLines (the contrib build alone)."""
        return self._edge_drawing is not None

    def chain(self, image: Image) -> tuple[Float32Array, dict[str, float]]:
        """Vectorize by the stock chain.

        Args:
            image: (H, W) uint8.

        Returns:
            Segments (N, 4) float32, x1 y1 x2 y2, px, of at least 12 px; and the ms of each step.
        """
        marks = [time.perf_counter()]
        even = np.asarray(self._clahe.apply(image), np.uint8)
        marks.append(time.perf_counter())
        edges = np.asarray(cv2.Canny(even, *_CANNY), np.uint8)
        marks.append(time.perf_counter())
        thin = self.skeleton.apply(edges)
        marks.append(time.perf_counter())
        segments = _polygons(thin)
        marks.append(time.perf_counter())
        names = ("clahe", "canny", "skeleton", "contours_polygons")
        spent = dict(zip(names, (1e3 * np.diff(marks)).tolist(), strict=True))
        return segments, spent

    def lsd(self, image: Image) -> Float32Array:
        """Vectorize by CLAHE and LSD; (N, 4) float32, px."""
        return _rows(self._lsd.detect(self._clahe.apply(image))[0])

    def edlines(self, image: Image) -> Float32Array:
        """Vectorize by CLAHE and EDLines; (N, 4) float32, px.

        Raises:
            RuntimeError: OpenCV has it not; see ``has_edlines``.
        """
        if self._edge_drawing is None:
            raise RuntimeError("EDLines needs the contrib build of OpenCV")
        self._edge_drawing.detectEdges(self._clahe.apply(image))
        return _rows(self._edge_drawing.detectLines())

    def probabilistic_hough(self, image: Image) -> Float32Array:
        """Vectorize by CLAHE, Canny and HoughLinesP; (N, 4) float32, px."""
        edges = cv2.Canny(self._clahe.apply(image), *_CANNY)
        found = cv2.HoughLinesP(edges, 1, np.pi / 180, 50, minLineLength=_MIN_LENGTH, maxLineGap=3)
        return _rows(found)


def draw_edges(segments: Float32Array, size: tuple[int, int]) -> Image:
    """Draw segments one pixel wide; (H, W) uint8, 255 on them: the same edges as pixels."""
    edges = np.zeros((size[1], size[0]), np.uint8)
    ends = np.rint(segments).astype(np.int32).reshape(-1, 2, 2)
    cv2.polylines(edges, list(ends), isClosed=False, color=255)
    return edges


def pixel_hough(edges: Image, least: int) -> Any:
    """Find lines by the pixel Hough transform, in steps of a pixel and a degree.

    Args:
        edges: (H, W) uint8, above 0 on edges.
        least: pixels on a line at least.

    Returns:
        (N, 1, 2) float32, ρ and θ; None without lines.
    """
    return cv2.HoughLines(edges, 1.0, np.pi / 180, least)


def _polygons(edges: Image) -> Float32Array:
    contours, _ = cv2.findContours(edges, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    lines = [cv2.approxPolyDP(contour, _TOLERANCE, closed=False) for contour in contours]
    if not lines:
        return np.zeros((0, 4), np.float32)
    # All at once, so that it is OpenCV that is timed: a piece from each point to the next, but for
    # the last of a contour.
    points = np.concatenate(lines)[:, 0].astype(np.float32)
    pieces = np.concatenate((points[:-1], points[1:]), axis=1)
    inside = np.ones(len(points), bool)
    inside[np.cumsum([len(line) for line in lines]) - 1] = False
    across = pieces[:, 2:] - pieces[:, :2]
    long = np.hypot(across[:, 0], across[:, 1]) >= _MIN_LENGTH
    return np.asarray(pieces[inside[:-1] & long], np.float32)


def _rows(found: Any) -> Float32Array:
    if found is None:
        return np.zeros((0, 4), np.float32)
    return np.asarray(found, np.float32).reshape(-1, 4)
