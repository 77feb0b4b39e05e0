"""A stereo pair as segments, matches and thumbnails (4.1.1)."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, Unseen, UnseenPair
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import VectorizedStereo
from pipeline_tracker.vectorization.segments import (
    EDGE_REACH,
    extract_segments,
    pyramid,
    shrink,
    to_full_size,
)
from pipeline_tracker.vectorization.stereo_matching import match_pair
from pipeline_tracker.vectorization.working_size import working_factor
from pipeline_tracker.workspace import Workspace

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

_REFERENCE_WIDTH = 1200
# Edges are sought in images at most so wide, px: twice as many pixels along each side would cost
# four times as much, and show no more of the pipe's contours.
_FINEST_WIDTH = 800
_COARSEST_WIDTH = 220
_COARSE_MIN_LENGTH = 10.0


class Vectorizer:
    """Vectorizes stereo pairs; keeps arrays to compute in, but nothing of what was in them."""

    def __init__(self, settings: Settings) -> None:
        self._spacing = settings.vectorization.match_spacing
        self._left, self._right = _Side(settings), _Side(settings)
        self._workspace = Workspace()
        # On a second core, where there is one, the right image is worked on beside the left one.
        self._worker = ThreadPoolExecutor(1) if cores() > 1 else None

    def process(
        self,
        stamp_ns: int,
        rig: StereoRig,
        left: Image,
        right: Image | None,
        unseen: UnseenPair = SEEN_WHOLE,
    ) -> VectorizedStereo:
        """Vectorize a rectified pair (or a left image alone).

        Args:
            stamp_ns: stamp of the left image, ns.
            rig: the cameras; their size is that of the images.
            left, right: (H, W) uint8; right None in mono.
            unseen: what of them the cameras have not seen; no segment and no match comes from it.

        Returns:
            Segments of both images from fine to coarse, matches and thumbnails.
        """
        start = time.perf_counter()
        factor = working_factor(left.shape[1])
        levels = [pyramid(_working(image, factor)) for image in (left, right) if image is not None]
        if right is None:
            left_segments = self._left.segments(levels[0], factor, unseen.left)
            right_segments = matches = np.zeros((0, 4), np.float32)
        elif self._worker is None:
            left_segments = self._left.segments(levels[0], factor, unseen.left)
            right_segments = self._right.segments(levels[1], factor, unseen.right)
            matches = self._matches(levels, left_segments, unseen, factor)
        else:
            beside = self._worker.submit(self._right.segments, levels[1], factor, unseen.right)
            left_segments = self._left.segments(levels[0], factor, unseen.left)
            matches = self._matches(levels, left_segments, unseen, factor)
            right_segments = beside.result()
        return VectorizedStereo(
            stamp_ns=stamp_ns,
            rig=rig,
            left_segments=left_segments,
            right_segments=right_segments,
            matches=matches,
            left_thumbnail=thumbnail(left),
            right_thumbnail=np.zeros((0, 0), np.uint8) if right is None else thumbnail(right),
            processing_time=time.perf_counter() - start,
        )

    def _matches(
        self,
        levels: list[list[Image]],
        segments: Float32Array,
        unseen: UnseenPair,
        factor: int,
    ) -> Float32Array:
        left, right = levels
        self._workspace.begin(left[0].shape)
        scale = left[0].shape[1] / _REFERENCE_WIDTH
        spacing = max(6, round(self._spacing * scale))
        along = (segments + np.float32(0.5)) / np.float32(factor) - np.float32(0.5)
        matches = match_pair(left, right, along, spacing, self._workspace, unseen, factor)
        return to_full_size(matches, factor)


class _Side:
    """Vectorizes the images of one camera, in arrays of its own: two of them work side by side."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings.vectorization
        self._workspace = Workspace()

    def segments(self, levels: list[Image], factor: int, unseen: Unseen | None) -> Float32Array:
        """Find segments fine and coarse: coarse edges survive fouling.

        Args:
            levels: the pyramid of an image at its working size.
            factor: of that size to the full one.
            unseen: what of the full image the camera has not seen.

        Returns:
            (N, 4) float32, px of the full image.
        """
        working = levels[0]
        self._workspace.begin(working.shape)
        finest = 0 if working.shape[1] <= _FINEST_WIDTH else 1
        found = []
        for level in range(finest, len(levels)):
            image, side = levels[level], 2**level
            small = level > finest and image.shape[1] < _COARSEST_WIDTH
            if small or min(image.shape) < 16:
                break
            min_length = self._min_length(image.shape[1], level > finest)
            blind = None if unseen is None else unseen.grown(side * factor, EDGE_REACH)
            tolerance = self._settings.split_tolerance
            part = extract_segments(image, tolerance, min_length, self._workspace, blind)
            found.append(to_full_size(part, side * factor))
        return np.concatenate(found) if found else np.zeros((0, 4), np.float32)

    def _min_length(self, width: int, coarse: bool) -> float:
        """Return the length of the shortest segments of an image of a width, px of it."""
        scaled = self._settings.min_length * width / _REFERENCE_WIDTH
        return max(scaled, _COARSE_MIN_LENGTH if coarse else 6.0)


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _working(image: Image, factor: int) -> Image:
    """Shrink an image to its working size; a contiguous view that cannot be written to.

    Kernels are compiled anew for each kind of array; images of messages are of this kind anyway.
    """
    view = np.ascontiguousarray(shrink(image, factor)).view()
    view.flags.writeable = False
    return view


def thumbnail(image: Image) -> Image:
    """Shrink an image to an eighth of each side, rounded down, averaging; uint8."""
    return pyramid(image)[-1]
