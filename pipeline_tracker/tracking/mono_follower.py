"""One camera: echoes of the way behind and the contours of this image, put together (5.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.acceptance import too_uncertain
from pipeline_tracker.axis_fit import Axis, Prior
from pipeline_tracker.echoes import Echoes, PlacedEcho
from pipeline_tracker.evidence import REFERENCE_WIDTH
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.mono import LEAST_HITS, MonoFit, fit_mono
from pipeline_tracker.pipe_segment import published_covariance
from pipeline_tracker.settings import Settings
from pipeline_tracker.tracking.echo_trail import EchoTrail
from pipeline_tracker.types import Contours, VectorizedStereo

Array = NDArray[np.float64]

# Places of an axis that are remembered, m from the middle of the view.
_PLACES = (-0.5, 0.0, 0.5)
# Errors of left, up, heading and pitch, measured on rendered seas, are so much of what edges and
# echoes together give.
_MEASURED = np.array([0.8, 0.7, 1.4, 1.0])
# Height is what one camera knows least. With a larger standard deviation, m, it may well be off by
# 5 cm.
_MOST_HEIGHT = 0.025
# Share of each contour's visible length that must be borne by segments.
_LEAST_ALONE, _LEAST_MEAN_SHARE_ALONE = 0.22, 0.3
# The same where echoes met the pipe.
_LEAST_HEARD, _LEAST_MEAN_SHARE_HEARD = 0.12, 0.22
# Edges spread more widely about a contour leave open which of them it is: px at 1200 px width, but
# no less than so many px of a small image. Where the width alone tells the distance, edges further
# off are looked at, clutter among them.
_MOST_SPREAD_HEARD, _MOST_SPREAD_ALONE = 2.1, 3.0
_LEAST_SPREAD_PX_HEARD, _LEAST_SPREAD_PX_ALONE = 1.0, 0.8


class MonoFollower:
    """Fits and judges the frames of one camera; keeps the echoes that help it."""

    def __init__(self, settings: Settings, mounting: Pose) -> None:
        """Start without echoes.

        Args:
            settings: the pipe's radius and ``altimeter.max_age`` are used.
            mounting: base_link <- left optical frame.
        """
        self._radius = settings.radius
        self._mounting = mounting
        self._to_optical = mounting.inverse()
        self._trail = EchoTrail(settings.altimeter.max_age)

    def hear(self, echoes: Sequence[PlacedEcho]) -> None:
        """Take in what was heard since the last frame."""
        self._trail.add(echoes)

    def forget(self) -> None:
        """Forget all echoes."""
        self._trail.clear()

    def around(self, stamp_ns: int, pose: Pose | None) -> Echoes:
        """Return what is of use for a frame, see ``EchoTrail.around``."""
        return self._trail.around(stamp_ns, pose)

    def fit(
        self,
        frame: VectorizedStereo,
        pose: Pose | None,
        start: Axis,
        vertical: Array,
        prior: Prior | None = None,
    ) -> tuple[MonoFit | None, Array, str]:
        """Fit the axis in a frame and say whether the image bears it.

        Args:
            frame: the vectorized image.
            pose: odom <- base_link at its stamp, or None.
            start: rough axis, left optical frame.
            vertical: unit vector up, left optical frame.
            prior: how well the start is known.

        Returns:
            The fit (None where it went astray), its covariance as published, 4 x 4, and why it is
            refused (empty where it is not).
        """
        echoes = self.around(frame.stamp_ns, pose).seen_from(self._to_optical)
        found = fit_mono(frame, start, self._radius, vertical, echoes, prior)
        if found is None:
            return None, np.zeros((4, 4)), "fit_went_astray"
        covariance = published_covariance(found.fit, found.support)
        reason = mono_refusal(found, frame.rig.left)
        distance = float(np.linalg.norm(found.fit.axis.point))
        echoed = found.hits >= LEAST_HITS
        unsure = too_uncertain(covariance, distance)
        if echoed:
            covariance = covariance * np.outer(_MEASURED, _MEASURED)
            unsure |= bool(covariance[1, 1] > _MOST_HEIGHT**2)
        if not reason and unsure:
            reason = "too_uncertain"
        if not reason and pose is not None:
            places = np.stack([found.fit.axis.at(t) for t in _PLACES])
            self._trail.see(pose.apply(self._mounting.apply(places)))
        return found, covariance, reason


def mono_refusal(found: MonoFit, camera: Camera) -> str:
    """Return why one image does not bear a pipe; empty where it does."""
    shares = {contour.bit: contour.share for contour in found.support.contours}
    if set(shares) != {Contours.LEFT_IMAGE_LEFT, Contours.LEFT_IMAGE_RIGHT}:
        return "one_contour_only"
    heard = found.hits >= LEAST_HITS
    least = _LEAST_HEARD if heard else _LEAST_ALONE
    if min(shares.values()) < least:
        return "one_contour_only" if max(shares.values()) >= _LEAST_ALONE else "too_little_contour"
    mean = _LEAST_MEAN_SHARE_HEARD if heard else _LEAST_MEAN_SHARE_ALONE
    if found.support.contour_share < mean:
        return "too_little_contour"
    wide = _MOST_SPREAD_HEARD if heard else _MOST_SPREAD_ALONE
    pixels = _LEAST_SPREAD_PX_HEARD if heard else _LEAST_SPREAD_PX_ALONE
    most = max(wide, pixels * REFERENCE_WIDTH / camera.width)
    return "contours_not_clear" if found.spread > most else ""
