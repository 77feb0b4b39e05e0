"""From a rough axis to the joint fit of surface and contours, in a few rounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, AxisFit, Evidence, Prior, fit_axis
from pipeline_tracker.evidence import gather, nearby
from pipeline_tracker.face import exposed_points
from pipeline_tracker.pipe_segment import middle_of_view
from pipeline_tracker.surface import SurfacePoints
from pipeline_tracker.types import VectorizedStereo

Array = NDArray[np.float64]

_WIDE = (24.0, 12.0, 6.0, 4.0)
_NARROW = (6.0, 4.0, 4.0)
# Segments that far from the predicted contour are looked at, px at 1200 px width.
_FIRST_GATE, _LATER_GATE = 14.0, 5.0
_COVER_ROUNDS = 3
# Gate, robust widths, and whether only the surface is fitted.
_ROUNDS = (
    (_FIRST_GATE, _WIDE, True),
    (_LATER_GATE, _NARROW, True),
    (_LATER_GATE, _NARROW, False),
    (_LATER_GATE, _NARROW, False),
)


def refine(
    frame: VectorizedStereo,
    surface: SurfacePoints,
    start: Axis,
    radius: float,
    vertical: Array,
    prior: Prior | None = None,
    by_contours: bool = False,
) -> AxisFit | None:
    """Fit the axis to what the pictures show near a rough one.

    The surface comes first: of several lines side by side (contour, foot of the pipe, edge of the
    shadow) only the surface tells which is the contour. Where it has too few points, the contours
    stand alone.

    Args:
        frame: the vectorized pair.
        surface: its triangulated matches.
        start: rough axis, left optical frame, within about 10 cm and 3 degrees.
        radius: m.
        vertical: unit vector up, left optical frame.
        prior: how well the start is known.
        by_contours: the start comes from contours, so that its own contours are near it.

    Returns:
        The fit, its origin in the middle of the view; None where it went astray.
    """
    camera = frame.rig.left
    axis = start.moved(middle_of_view(start, camera))
    frame, surface = nearby(frame, surface, axis, radius)
    fit: AxisFit | None = None
    for gate, widths, surface_only in _ROUNDS:
        near = min(gate, _LATER_GATE) if by_contours else gate
        evidence = gather(frame, surface, axis, radius, near, surface_only=surface_only)
        if not _enough(evidence):
            return None
        fit = fit_axis(axis, radius, evidence, vertical, prior, widths)
        axis = fit.axis
        if not _sane(axis, start, radius):
            return None
        axis = axis.moved(middle_of_view(axis, camera))
    if fit is None:
        return None
    # Where something lies on the pipe its surface is not the pipe's: fit to the rest alone.
    for _ in range(_COVER_ROUNDS):
        exposed = exposed_points(surface, camera, axis, radius)
        if exposed.all():
            break
        evidence = gather(frame, surface.subset(exposed), axis, radius, _LATER_GATE)
        if not _enough(evidence):
            break
        fit = fit_axis(axis, radius, evidence, vertical, prior, _NARROW)
        axis = fit.axis
        if not _sane(axis, start, radius):
            return None
        axis = axis.moved(middle_of_view(axis, camera))
    return replace(fit, axis=axis)


def _enough(evidence: Evidence) -> bool:
    return len(evidence.points) + len(evidence.rays) >= 6


def _sane(axis: Axis, start: Axis, radius: float) -> bool:
    """Whether the fit stayed near its start and before the camera."""
    if not np.isfinite(axis.rows).all() or axis.point[2] <= radius:
        return False
    return float(abs(axis.direction @ start.direction)) > 0.9
