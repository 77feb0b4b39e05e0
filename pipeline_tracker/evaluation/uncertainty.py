"""Errors of a segment at its middle, and how they stand to its published covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Regions that are looked at, per cent.
LEVELS = (50.0, 80.0, 90.0, 95.0, 99.0)


@dataclass(frozen=True)
class Uncertainty:
    """How errors of a segment stand to its covariance.

    Attributes:
        sigmas: of left m, up m, heading rad, pitch rad; (4,).
        nees: squared (left, up) in units of its covariance; None where that is no covariance.
        direction_nees: squared (heading, pitch), likewise.
    """

    sigmas: Array
    nees: float | None
    direction_nees: float | None


def segment_offsets(start: Array, end: Array, foot: Array, line: Array) -> Array | None:
    """Return how far a segment is off the true axis at its middle.

    Args:
        start, end: of the segment in world, (3,), m.
        foot: the point of the true axis nearest to its middle, (3,), m.
        line: direction of the true axis beside the segment, either way, (3,), unit.

    Returns:
        Segment less axis, (4,): left (horizontal, across the segment) m, up (normal to it in its
        vertical plane) m, heading rad, pitch rad; None for a vertical segment, which has no left.
    """
    way = (end - start) / np.linalg.norm(end - start)
    left = np.array([-way[1], way[0], 0.0])
    across = float(np.linalg.norm(left))
    if not across > 0.0:
        return None
    left /= across
    error = (start + end) / 2.0 - foot
    line = line if float(line @ way) >= 0.0 else -line
    turn = math.atan2(way[1], way[0]) - math.atan2(line[1], line[0])
    climb = math.atan2(way[2], across) - math.atan2(line[2], math.hypot(line[0], line[1]))
    sides = [float(error @ left), float(error @ np.cross(way, left))]
    return np.array([*sides, math.remainder(turn, 2.0 * math.pi), climb])


def weigh(offsets: Array, covariance: Array) -> Uncertainty | None:
    """Weigh errors by a covariance.

    Args:
        offsets: left, up, heading, pitch, (4,).
        covariance: of these, 4 x 4.

    Returns:
        None where a variance is not a positive number.
    """
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and (variances > 0.0).all()):
        return None
    return Uncertainty(
        sigmas=np.sqrt(variances),
        nees=_nees(offsets[:2], covariance[:2, :2]),
        direction_nees=_nees(offsets[2:], covariance[2:, 2:]),
    )


def _nees(offsets: Array, covariance: Array) -> float | None:
    if not np.linalg.det(covariance) > 0.0:
        return None
    return float(offsets @ np.linalg.solve(covariance, offsets))


def chi2_quantile(share: float) -> float:
    """Return the squared radius within which a share of a two-dimensional normal lies."""
    return -2.0 * math.log1p(-share)
