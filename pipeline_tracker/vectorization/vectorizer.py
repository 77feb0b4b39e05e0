"""A stereo pair as segments, matches and thumbnails (4.1.1)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, Unseen, UnseenPair
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import VectorizedStereo
from pipeline_tracker.vectorization.segments import (
    EDGE_REACH,
    equalize,
    extract_segments,
    shrink,
    to_full_size,
)
from pipeline_tracker.vectorization.stereo_matching import match_pair
from pipeline_tracker.vectorization.working_size import working_factor
from pipeline_tracker.workspace import Workspace

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

_REFERENCE_WIDTH = 1200
_COARSEST_WIDTH = 220
_COARSE_MIN_LENGTH = 10.0
_THUMBNAIL = 8


class Vectorizer:
    """Vectorizes stereo pairs; keeps arrays to compute in, but nothing of what was in them."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings.vectorization
        self._workspace = Workspace()

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
        left = _read_only(left)
        self._workspace.begin(left.shape)
        left_segments = self._segments(left, unseen.left)
        if right is None:
            right_segments = np.zeros((0, 4), np.float32)
            matches = np.zeros((0, 4), np.float32)
            right_thumbnail = np.zeros((0, 0), np.uint8)
        else:
            right = _read_only(right)
            right_segments = self._segments(right, unseen.right)
            matches = self._matches(left, right, left_segments, unseen)
            right_thumbnail = thumbnail(right)
        return VectorizedStereo(
            stamp_ns=stamp_ns,
            rig=rig,
            left_segments=left_segments,
            right_segments=right_segments,
            matches=matches,
            left_thumbnail=thumbnail(left),
            right_thumbnail=right_thumbnail,
            processing_time=time.perf_counter() - start,
        )

    def _segments(self, image: Image, unseen: Unseen | None) -> Float32Array:
        """Segments at the working size, at half of it and so on: coarse edges survive fouling."""
        factor = working_factor(image.shape[1])
        even = equalize(shrink(image, factor), workspace=self._workspace)
        scale = even.shape[1] / _REFERENCE_WIDTH
        min_length = max(6.0, self._settings.min_length * min(1.0, scale))
        levels = []
        step = 1
        while step == 1 or even.shape[1] // step >= _COARSEST_WIDTH:
            part = shrink(even, step)
            if min(part.shape) < 16:
                break
            least = min_length if step == 1 else min(min_length, _COARSE_MIN_LENGTH)
            blind = None if unseen is None else unseen.grown(step * factor, EDGE_REACH)
            found = extract_segments(
                part, self._settings.split_tolerance, least, self._workspace, blind
            )
            levels.append(to_full_size(found, step * factor))
            step *= 2
        if not levels:
            return np.zeros((0, 4), np.float32)
        return np.concatenate(levels)

    def _matches(
        self, left: Image, right: Image, segments: Float32Array, unseen: UnseenPair
    ) -> Float32Array:
        factor = working_factor(left.shape[1])
        small_left, small_right = shrink(left, factor), shrink(right, factor)
        scale = small_left.shape[1] / _REFERENCE_WIDTH
        spacing = max(6, round(self._settings.match_spacing * scale))
        along = (segments + np.float32(0.5)) / np.float32(factor) - np.float32(0.5)
        matches = match_pair(
            small_left, small_right, along, spacing, self._workspace, unseen, factor
        )
        return to_full_size(matches, factor)


def _read_only(image: Image) -> Image:
    """Return a contiguous view that cannot be written to.

    Kernels are compiled anew for each kind of array; images of messages are of this kind anyway.
    """
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view


def thumbnail(image: Image) -> Image:
    """Shrink an image to an eighth of each side, rounded down, averaging; uint8."""
    return shrink(image, _THUMBNAIL)
