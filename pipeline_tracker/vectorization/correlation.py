"""How much alike patches of two images are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled_sums

Image = NDArray[np.uint8]

# Half size of the patches, px.
HALF = 5
_SIDE = 2 * HALF + 1


@compiled_sums
def correlations(
    left: Image, right: Image, xl: int, yl: int, xr: int, yr: int
) -> tuple[float, float, float]:
    """Zero-mean normalised cross-correlation of patches, 11 x 11 px, -1 to 1.

    The caller keeps all patches inside the images. Patches without any contrast give -1.

    Args:
        left, right: (H, W) uint8.
        xl, yl: the middle of the patch in the left image, px.
        xr, yr: of the patch in the right one, px.

    Returns:
        That with the patch one column before ``xr``, at ``xr`` and one after.
    """
    sl = s0 = s1 = s2 = sll = s00 = s11 = s22 = sl0 = sl1 = sl2 = np.int32(0)
    for j in range(-HALF, HALF + 1):
        one = left[yl + j, xl - HALF : xl + HALF + 1]
        other = right[yr + j, xr - HALF - 1 : xr + HALF + 2]
        for i in range(_SIDE):
            a = np.int32(one[i])
            b0, b1, b2 = np.int32(other[i]), np.int32(other[i + 1]), np.int32(other[i + 2])
            sl += a
            s0 += b0
            s1 += b1
            s2 += b2
            sll += a * a
            s00 += b0 * b0
            s11 += b1 * b1
            s22 += b2 * b2
            sl0 += a * b0
            sl1 += a * b1
            sl2 += a * b2
    return (
        _normalised(sl, s0, sll, s00, sl0),
        _normalised(sl, s1, sll, s11, sl1),
        _normalised(sl, s2, sll, s22, sl2),
    )


@compiled_sums
def _normalised(sl: np.int32, sr: np.int32, sll: np.int32, srr: np.int32, slr: np.int32) -> float:
    n = float(_SIDE * _SIDE)
    left, right = float(sl), float(sr)
    spread = (n * float(sll) - left * left) * (n * float(srr) - right * right)
    return (n * float(slr) - left * right) / float(np.sqrt(spread)) if spread > 0.0 else -1.0
