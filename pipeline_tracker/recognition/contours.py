"""Which contours? Hypotheses for the pipe from pairs of image lines (4.2.1, 4.2.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.recognition.groups import form_groups
from pipeline_tracker.recognition.hough import HoughLine, hough_lines
from pipeline_tracker.recognition.techniques import technique2
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]

# Thresholds at 1200 px width.
_GROUP_DISTANCE, _GROUP_ANGLE, _LONG = 8.0, 0.07, 30.0
_HEAVIEST_GROUPS = 24
_LINES = 12
REFERENCE_WIDTH = 1200.0
# A pipe nearer than this many radii fills the picture; one further than this many diameters is a
# line to the method.
_NEAREST_RADII, _FURTHEST_DIAMETERS = 1.2, 40.0


def contour_candidates(segments: Float32Array, camera: Camera) -> list[HoughLine]:
    """Find the lines of an image that may be contours (4.2.2, 4.2.3).

    The modified Hough transform runs on the full set of segments and on the heaviest groups; lines
    found by both are kept once.

    Args:
        segments: (N, 4) float32, px.
        camera: the camera they were seen by.
    """
    scale = camera.width / REFERENCE_WIDTH
    size = (camera.width, camera.height)
    distance = max(3.0, 6.0 * scale)
    centre = ((camera.width - 1) / 2.0, (camera.height - 1) / 2.0)
    groups = form_groups(
        segments, centre, max(3.0, _GROUP_DISTANCE * scale), _GROUP_ANGLE, _LONG * scale
    )
    lines = hough_lines(segments, size, most=_LINES, distance=distance)
    if groups:
        members = np.concatenate([group.members for group in groups[:_HEAVIEST_GROUPS]])
        lines += hough_lines(segments[members], size, most=_LINES, distance=distance)
    kept: list[HoughLine] = []
    for line in sorted(lines, key=lambda entry: -entry.weight):
        if not any(_same_line(line.line, other.line, camera, distance) for other in kept):
            kept.append(line)
    return kept[:_LINES]


def _same_line(a: Array, b: Array, camera: Camera, distance: float) -> bool:
    if abs(float(a[:2] @ b[:2])) < np.cos(0.05):
        return False
    sign = 1.0 if float(a[:2] @ b[:2]) > 0 else -1.0
    centre = np.array([camera.cx, camera.cy])
    gap = float(a[:2] @ centre) + a[2] - sign * (float(b[:2] @ centre) + b[2])
    return bool(abs(gap) < distance)


def pair_hypotheses(
    lines: list[HoughLine], camera: Camera, radius: float
) -> list[tuple[Axis, float]]:
    """Pair lines to contours and compute the axis of each pair by technique 2.

    A pair is dropped where the distance that it implies is not one at which a pipe can be seen.
    What it is a pair of (contours, a shadow, a cable) is for the surface and the other image to
    tell.

    Args:
        lines: contour candidates of one image.
        camera: its camera.
        radius: m.

    Returns:
        Axes (left optical frame) with the weight of their two lines, px.
    """
    found = []
    for i, first in enumerate(lines):
        for second in lines[i + 1 :]:
            # Contours converge, but not by more than a wide-angle view of a near pipe allows.
            if abs(float(first.line[:2] @ second.line[:2])) < 0.75:
                continue
            axis = technique2(first.line, second.line, camera, radius)
            if axis is None or axis.point[2] <= radius:
                continue
            distance = float(np.linalg.norm(axis.point - camera.centre))
            if not _NEAREST_RADII * radius < distance < _FURTHEST_DIAMETERS * 2.0 * radius:
                continue
            found.append((axis, first.weight + second.weight))
    return found
