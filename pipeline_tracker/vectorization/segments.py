"""An image as straight segments, from fine to coarse (4.1.1)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.vectorization.chains import trace_segments
from pipeline_tracker.vectorization.edges import (
    NO_EDGE,
    gradient_magnitude,
    magnitude_quantile,
    suppress_non_maxima,
)
from pipeline_tracker.workspace import Workspace

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

# Share of pixels whose gradient stays below the upper threshold. A share, not a value: hazy sand
# and a lamp's glare then give alike numbers of edges. The lower threshold is a part of the upper.
_HIGH_QUANTILE = 0.93
_LOW_PART = 0.45
# The quantile is that of every third pixel of every third row.
_SAMPLE = 3
# Below this the gradient is the camera's noise, in units of the Sobel operator.
_LEAST_HIGH = 12.0
# Against noise, and the two ridges that a diagonal edge leaves: size and sigma, px.
_BLUR, _BLUR_SIGMA = (5, 5), 1.2
# An edge is made of pixels up to so far from it: blur, derivatives, suppression.
EDGE_REACH = 4
# The border of an image has no edges; a smaller one is border all through.
_LEAST_SIDE = 5


def extract_segments(
    image: Image,
    tolerance: float,
    min_length: float,
    workspace: Workspace | None = None,
    blind: NDArray[np.bool_] | None = None,
) -> Float32Array:
    """Vectorize one image at one scale.

    Args:
        image: (H, W) uint8.
        tolerance: a broken line is split where it deviates by more, px.
        min_length: shorter segments are dropped, px.
        workspace: where to compute; None: in new arrays.
        blind: (H, W), where no edges are to be found; None: nowhere.

    Returns:
        (N, 4) float32, x1 y1 x2 y2, px; the brighter side lies to the right of 1 -> 2.
    """
    shape = image.shape
    if min(shape) < _LEAST_SIDE:
        return np.zeros((0, 4), np.float32)
    array = (workspace or Workspace()).array
    dx, dy = array("dx", shape, np.int16), array("dy", shape, np.int16)
    magnitude, ridge = array("magnitude", shape, np.float32), array("ridge", shape, np.uint8)
    smooth = cv2.GaussianBlur(image, _BLUR, _BLUR_SIGMA, dst=array("smooth", shape, np.uint8))
    cv2.spatialGradient(smooth, dx, dy)
    gradient_magnitude(dx, dy, magnitude)
    high = max(magnitude_quantile(magnitude, _HIGH_QUANTILE, _SAMPLE), _LEAST_HIGH)
    suppress_non_maxima(dx, dy, magnitude, _LOW_PART * high, high, ridge)
    if blind is not None:
        ridge[blind] = NO_EDGE
    return trace_segments(ridge, dx, dy, magnitude, tolerance, min_length)


def shrink(image: Image, factor: int) -> Image:
    """Shrink an image by a whole factor, averaging; rows and columns left over are dropped.

    A smaller image than the factor leaves nothing: a side of 0.
    """
    if factor == 1:
        return image
    height, width = image.shape[0] // factor, image.shape[1] // factor
    if height == 0 or width == 0:
        return np.zeros((height, width), np.uint8)
    part = image[: height * factor, : width * factor]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def pyramid(image: Image) -> list[Image]:
    """Return an image, (H, W) uint8, a half of it, a quarter and an eighth, each by averaging.

    A small image may leave nothing of the last.
    """
    levels = [image]
    for _ in range(3):
        levels.append(shrink(levels[-1], 2))
    return levels


def to_full_size(coordinates: Float32Array, factor: int) -> Float32Array:
    """Take pixel coordinates of a shrunk image to those of the full one (centres at integers)."""
    return ((coordinates + np.float32(0.5)) * np.float32(factor) - np.float32(0.5)).astype(
        np.float32
    )
