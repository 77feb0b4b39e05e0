"""When the pictures bear a pipe, and when they do not, with the reason in a word."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.support import Support
from pipeline_tracker.types import Contours

# Measured on rendered seas, of the points on the face that are not covered: a pipe is better than a
# plane by 0.6 and more each, overgrown, half buried or 4 m away, less what is seen through it; beds
# with stones, ledges, cables and weed reach 0.25.
FULL_GAIN = 1.2
LEAST_EXPOSED = 0.45
LEAST_GAIN, LEAST_FACE_SHARE = 0.5, 0.7
COVERED_FACE_SHARE, COVERED_POINTS = 0.25, 60
LEAST_CONTOUR_SHARE, EXPOSED_CONTOUR_SHARE = 0.12, 0.05
GOOD_CONTOUR_SHARE, GOOD_LEAST_GAIN, GOOD_LEAST_FACE_SHARE = 0.3, 0.2, 0.8
CLEAR_CONTOUR_SHARE, CLEAR_LEAST_GAIN = 0.5, -0.1
STRONG_GAIN, STRONG_FACE_SHARE = 1.0, 0.92
# Where the face has no texture to match, the contours alone must speak.
ALONE_CONTOUR_SHARE = 0.35
# A contour that is supported along half of its length is all that can be hoped for in the sea.
FULL_CONTOUR_SHARE = 0.5

# What an autopilot may steer by: standard deviations of left and up for each metre of distance, and
# at least; of heading and pitch.
_OFFSET_PER_METRE, _LEAST_OFFSET, _ANGLE = 0.0125, 0.025, 0.033

_LEFT_PAIR = Contours.LEFT_IMAGE_LEFT | Contours.LEFT_IMAGE_RIGHT
_RIGHT_PAIR = Contours.RIGHT_IMAGE_LEFT | Contours.RIGHT_IMAGE_RIGHT


def support_share(support: Support) -> float:
    """Return the share of the expected evidence that was found, 0 to 1."""
    contours = min(1.0, support.contour_share / FULL_CONTOUR_SHARE)
    if not support.face_points:
        return contours
    # Each point that lies on the face gains, where the face is well seen, FULL_GAIN over a plane.
    surface = float(np.clip(support.face_gain / FULL_GAIN, 0.0, support.face_share))
    return 0.6 * surface + 0.4 * contours


def score(support: Support) -> float:
    """Return what hypotheses of one frame are ranked by."""
    if not support.face_points:
        return 0.8 * support_share(support)
    return support_share(support) - 0.5 * support.pierced_share


def refusal(support: Support, stereo: bool, followed: bool = False) -> str:
    """Return why the pictures do not bear a pipe; empty where they do.

    Args:
        support: what was found for and against the axis.
        stereo: whether there are two images.
        followed: whether a pipe was expected right here.
    """
    if support.face_points:
        return _refused_by_surface(support, followed)
    visible = support.visible
    if not support.contour_share >= ALONE_CONTOUR_SHARE:
        return "too_little_contour"
    if visible & _LEFT_PAIR != _LEFT_PAIR:
        return "one_contour_only"
    if stereo and visible & _RIGHT_PAIR != _RIGHT_PAIR:
        return "cameras_disagree"
    return ""


def beyond_doubt(support: Support) -> bool:
    """Tell whether surface and contours agree so well that no other hypothesis can be better."""
    return (
        support.face_points >= COVERED_POINTS
        and support.face_share >= STRONG_FACE_SHARE
        and support.face_gain >= STRONG_GAIN
        and support.contour_share >= GOOD_CONTOUR_SHARE
    )


def _refused_by_surface(support: Support, followed: bool) -> str:
    gain, share = support.face_gain, support.face_share
    # Silt or growth lies on a part of the face: what is left is a cylinder all the same, as long
    # as hardly anything is seen through it.
    exposed = (
        share >= COVERED_FACE_SHARE
        and share * support.face_points >= COVERED_POINTS
        and gain / share - support.pierced_share >= LEAST_EXPOSED
    )
    shaped = share >= LEAST_FACE_SHARE and gain >= LEAST_GAIN
    # A short baseline or a wide angle makes cylinder and plane alike within the noise; where the
    # contours are good, it is enough that the surface does not speak against them.
    clear = support.contour_share >= CLEAR_CONTOUR_SHARE
    fitting = (
        support.contour_share >= GOOD_CONTOUR_SHARE
        and share >= GOOD_LEAST_FACE_SHARE
        and gain >= (CLEAR_LEAST_GAIN if clear else GOOD_LEAST_GAIN)
    )
    if not (exposed or shaped or fitting):
        return "surface_not_a_pipe"
    # A smooth hump of the bed is a cylinder too, but has no contours; where a pipe was followed to,
    # it is the pipe.
    least = EXPOSED_CONTOUR_SHARE if exposed else LEAST_CONTOUR_SHARE
    if exposed and followed:
        least = 0.0
    # Written so that NaN is refused.
    return "" if support.contour_share >= least else "too_little_contour"


def too_uncertain(covariance: NDArray[np.float64], distance: float) -> bool:
    """Tell whether an axis is known too poorly to steer by, however well it fits.

    Args:
        covariance: 4 x 4: left, up in m, heading, pitch in rad.
        distance: of the axis from the camera, m.
    """
    sigmas = np.sqrt(np.diag(covariance))
    offset = max(_LEAST_OFFSET, _OFFSET_PER_METRE * distance)
    # Written so that NaN is too uncertain.
    return not bool((sigmas[:2] < offset).all() and (sigmas[2:] < _ANGLE).all())
