"""The bed beside the pipe is measured where the images matched it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.report.bed import bed_beside
from pipeline_tracker.types import Mode, PipeSegment, VectorizedStereo

LEFT = Camera(900.0, 900.0, 599.5, 399.5, 1200, 800)
RIG = StereoRig(LEFT, replace(LEFT, offset=0.2))
MOUNTING = Pose.from_rpy([0.3, 0.1, -0.1], [-2.618, 0.0, -1.571])
RADIUS = 0.3
# The pipe leads 0.2 m to port of the vehicle, 2.2 m below it, and 20 degrees to port.
ALONG = np.array([np.cos(0.35), np.sin(0.35), 0.0])
ACROSS = np.array([-np.sin(0.35), np.cos(0.35), 0.0])
MIDDLE = np.array([1.4, 0.2, -2.2])
SEGMENT = PipeSegment(
    1, Mode.TRACKING, 0, MIDDLE - 0.25 * ALONG, MIDDLE + 0.25 * ALONG, RADIUS, np.eye(4), 0.9
)


def seen(left: float, right: float, *, tilt: Pose | None = None) -> VectorizedStereo:
    """Return matches on a bed so far below the axis to its left and right."""
    way, beside = np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.8, 0.8, 33))
    depth = np.where(beside > 0.0, left, right)
    points = MIDDLE + way[..., None] * ALONG + beside[..., None] * ACROSS
    points[..., 2] -= depth
    points = points.reshape(-1, 3) if tilt is None else tilt.inverse().apply(points.reshape(-1, 3))
    own = MOUNTING.inverse().apply(points)
    matches = np.hstack([camera.project(own) for camera in RIG.cameras]).astype(np.float32)
    nothing, grey = np.zeros((0, 4), np.float32), np.zeros((100, 150), np.uint8)
    return VectorizedStereo(1, RIG, nothing, nothing, matches, grey, grey)


@pytest.mark.parametrize(("left", "right"), [(0.3, 0.3), (0.6, 0.55), (0.3, -0.1), (-0.2, -0.25)])
def test_both_sides_are_measured_along_travel(left: float, right: float) -> None:
    measured = bed_beside(seen(left, right), SEGMENT, MOUNTING, Pose.identity())
    assert measured == (pytest.approx(left, abs=1e-3), pytest.approx(right, abs=1e-3))


def test_heights_are_along_the_vertical_of_the_pose() -> None:
    pose = Pose.from_rpy([5.0, 3.0, -10.0], [0.2, -0.1, 1.0])
    level = Pose.from_rpy([0.0, 0.0, 0.0], [0.2, -0.1, 0.0])
    turned = replace(
        SEGMENT,
        start=level.inverse().apply(SEGMENT.start),
        end=level.inverse().apply(SEGMENT.end),
    )
    measured = bed_beside(seen(0.5, 0.4, tilt=level), turned, MOUNTING, pose)
    assert measured == (pytest.approx(0.5, abs=1e-3), pytest.approx(0.4, abs=1e-3))


def test_a_pipe_that_climbs_is_measured_from_its_own_axis() -> None:
    rise = np.array([0.0, 0.0, 0.05])
    climbing = replace(SEGMENT, start=SEGMENT.start - rise, end=SEGMENT.end + rise)
    measured = bed_beside(seen(0.3, 0.3), climbing, MOUNTING, None)
    # The bed is level here: what the axis is above it at one end, it is below at the other.
    assert measured == (pytest.approx(0.3, abs=0.02), pytest.approx(0.3, abs=0.02))


def test_what_is_not_known_is_not_told() -> None:
    both = seen(0.3, 0.3)
    beside = MOUNTING.inverse().apply(MIDDLE - ACROSS * 1.0)[None]
    edge = LEFT.project(beside)[0, 0]
    # All that is right of the pipe is out of the pictures.
    cut = replace(both, matches=both.matches[both.matches[:, 0] < edge - 400.0])
    assert bed_beside(cut, SEGMENT, MOUNTING, None)[1] is None
    none = replace(both, matches=both.matches[:0])
    assert bed_beside(none, SEGMENT, MOUNTING, None) == (None, None)
    mono = replace(both, rig=StereoRig(LEFT))
    assert bed_beside(mono, SEGMENT, MOUNTING, None) == (None, None)
    upright = replace(SEGMENT, start=MIDDLE, end=MIDDLE + np.array([0.0, 0.0, 0.5]))
    assert bed_beside(both, upright, MOUNTING, None) == (None, None)
    assert bed_beside(both, PipeSegment.none(1, RADIUS), MOUNTING, None) == (None, None)
    # Matches that lie nowhere: no parallax, or behind the cameras.
    astray = replace(both, matches=both.matches[:, [0, 1, 0, 1]])
    assert bed_beside(astray, SEGMENT, MOUNTING, None) == (None, None)
