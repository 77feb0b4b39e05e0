"""The published piece of an axis: where it lies, how long it is, how sure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from synthetic_world import LEFT, RIG, TILTED

from pipeline_tracker.axis_fit import Axis, AxisFit, across
from pipeline_tracker.pipe_segment import (
    SegmentMaker,
    axis_of_segment,
    middle_of_view,
    published_covariance,
    segment_ends,
    turn_covariance,
)
from pipeline_tracker.settings import Settings
from pipeline_tracker.support import ContourSupport, Support
from pipeline_tracker.types import Contours, Mode, VectorizedStereo

Array = NDArray[np.float64]

SETTINGS = Settings.model_validate({"pipe": {"diameter": 0.6}, "segment": {"length": 0.5}})
BENT = Axis(
    np.array([0.2, 0.3, 2.0]),
    np.array([0.6, 0.8, 0.0]),
    np.array([-0.8, 0.6, 0.0]) / 30.0,
)


def from_optical_axis(point: Array) -> float:
    """Distance of a point from the left camera's optical axis, m."""
    return math.hypot(point[0], point[1])


def frame() -> VectorizedStereo:
    none = np.zeros((0, 4), np.float32)
    grey = np.zeros((100, 150), np.uint8)
    return VectorizedStereo(7, RIG, none, none, none, grey, grey)


headings, tilts = st.floats(0.0, 2.0 * math.pi), st.floats(-0.5, 0.5)


@given(headings, tilts, st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))
@settings(max_examples=50)
def test_the_middle_is_where_the_axis_passes_nearest_the_optical_axis(
    heading: float, tilt: float, x: float, y: float, along: float
) -> None:
    direction = np.array(
        [math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), math.sin(tilt)]
    )
    bend = np.cross(direction, [0.0, 0.0, 1.0]) / 40.0
    bend -= direction * (bend @ direction)
    axis = Axis(np.array([x, y, 2.5]) + along * direction, direction, bend)
    t = middle_of_view(axis, LEFT)
    places = np.linspace(-3.0, 3.0, 6001)
    away = [from_optical_axis(axis.at(place)) for place in places]
    assert from_optical_axis(axis.at(t)) <= min(away) + 1e-6


def test_the_middle_is_kept_inside_the_view() -> None:
    # The camera looks far forward along the pipe; abreast of the optical axis it is not in view:
    # the pipe climbs towards the camera and passes above the picture.
    axis = Axis.straight(np.array([0.0, 1.2, 1.5]), np.array([1.0, 0.0, 0.0]))
    t = middle_of_view(axis, LEFT)
    assert t == pytest.approx(0.0, abs=1e-9)
    slanted = Axis.straight(np.array([0.3, -1.5, 2.0]), np.array([0.05, 0.3, -0.95]))
    there = slanted.at(middle_of_view(slanted, LEFT))
    pixel = LEFT.project(there)
    assert there[2] > 0.0
    assert -1.0 <= pixel[0] <= 1200.0
    assert -1.0 <= pixel[1] <= 800.0


def test_an_axis_along_the_optical_axis_has_a_middle_too() -> None:
    axis = Axis.straight(np.array([0.0, 0.2, 2.0]), np.array([0.0, 0.0, 1.0]))
    assert math.isfinite(middle_of_view(axis, LEFT))


def test_the_piece_is_as_long_as_asked_and_on_the_bent_axis() -> None:
    axis = BENT.moved(middle_of_view(BENT, LEFT))
    start, end = segment_ends(axis, LEFT, 0.5)
    assert np.linalg.norm(end - start) == pytest.approx(0.5, abs=1e-3)
    curve = np.array([BENT.at(t) for t in np.linspace(-2.0, 2.0, 40_001)])
    for point in (start, end):
        assert np.linalg.norm(curve - point, axis=1).min() < 1e-4
    # End ahead of start, the middle between them.
    assert (end - start) @ axis.direction > 0.0
    middle = curve[int(np.argmin(np.hypot(curve[:, 0], curve[:, 1])))]
    assert np.linalg.norm(start - middle) == pytest.approx(0.25, abs=1e-3)
    assert np.linalg.norm(end - middle) == pytest.approx(0.25, abs=1e-3)


def test_it_is_shorter_where_less_is_in_view() -> None:
    # Up the picture, 0.6 m away: 800 px show 0.5 m of it.
    axis = Axis.straight(np.array([0.0, 0.0, 0.6]), np.array([0.0, 1.0, 0.0]))
    start, end = segment_ends(axis, LEFT, 1.5)
    assert np.linalg.norm(end - start) == pytest.approx(800.0 / 930.0 * 0.6, abs=1e-6)
    pixels = LEFT.project(np.stack((start, end)))
    assert np.allclose(pixels[:, 1], [-0.5, 799.5])


def test_a_made_segment_is_in_base_link_with_all_that_belongs_to_it() -> None:
    axis = BENT.moved(middle_of_view(BENT, LEFT))
    covariance = np.diag([1e-4, 2e-4, 3e-4, 4e-4])
    pieces = np.array([[10.0, 20.0, 30.0, 40.0], [30.0, 40.0, 50.0, 60.0]])
    contours = (
        ContourSupport(Contours.LEFT_IMAGE_LEFT, pieces, 40.0, 50.0),
        ContourSupport(Contours.LEFT_IMAGE_RIGHT, pieces, 1.0, 50.0),
        ContourSupport(Contours.RIGHT_IMAGE_RIGHT, pieces + 100.0, 40.0, 50.0),
    )
    support = Support(contours, 80, 0.9, 0.0, 2.0)
    made = SegmentMaker(SETTINGS, TILTED).make(frame(), axis, covariance, support, Mode.TRACKING, 0)
    start, end = segment_ends(axis, LEFT, 0.5)
    assert np.allclose(made.start, TILTED.rotation @ start + TILTED.translation)
    assert np.allclose(made.end, TILTED.rotation @ end + TILTED.translation)
    assert (made.stamp_ns, made.mode, made.technique, made.radius) == (7, Mode.TRACKING, 0, 0.3)
    # The straight piece cuts the bend: its middle is off the axis by the sag.
    sag = made.covariance - covariance
    assert np.array_equal(sag, np.diag(np.diag(sag)))
    off = axis.point - 0.5 * (start + end)
    assert sag.trace() == pytest.approx(float(off @ off), rel=1e-3)
    assert sag.trace() > 0.0
    assert made.visible_contours == Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_RIGHT
    assert made.contours == pytest.approx(np.array([[10, 20, 50, 60], [110, 120, 150, 160]]))
    assert 0.0 < made.support <= 1.0
    assert made.support == float(np.float32(made.support))
    back = axis_of_segment(made, TILTED)
    assert np.allclose(back.point, 0.5 * (start + end))
    assert np.allclose(back.direction, (end - start) / np.linalg.norm(end - start))


def test_the_published_covariance_is_no_less_than_the_fits() -> None:
    random = np.random.default_rng(1)
    root = 1e-3 * random.normal(size=(6, 6))
    left, up = across(BENT.direction, np.array([0.0, 0.0, -1.0]))
    fit = AxisFit(BENT, root @ root.T, left, up, 1.0, np.ones(0), np.ones(0))
    whole = Support((), 200, 0.95, 0.0, 1.5)
    published = published_covariance(fit, whole)
    assert np.array_equal(published, published.T)
    assert np.linalg.eigvalsh(published - fit.covariance[:4, :4]).min() > 0.0
    # Where something lies on the pipe, or the contours stand alone.
    covered = published_covariance(fit, replace(whole, face_share=0.5))
    assert np.linalg.eigvalsh(covered - published).min() > 0.0
    alone = published_covariance(fit, Support((), 0, 0.0, 0.0, 0.0))
    assert np.linalg.eigvalsh(published - alone).min() > 0.0
    assert np.linalg.eigvalsh(alone - fit.covariance[:4, :4]).min() > 0.0


@given(
    st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), headings, st.floats(-0.5, 0.5), st.integers(0, 99)
)
@settings(max_examples=50)
def test_a_covariance_for_another_vertical_is_that_of_the_same_errors(
    lean_x: float, lean_y: float, heading: float, tilt: float, seed: int
) -> None:
    direction = np.array(
        [math.cos(heading) * math.cos(tilt), math.sin(heading) * math.cos(tilt), math.sin(tilt)]
    )
    old_up = np.array([0.0, 0.0, 1.0])
    new_up = np.array([lean_x, lean_y, 1.0]) / math.sqrt(1.0 + lean_x**2 + lean_y**2)
    random = np.random.default_rng(seed)
    covariance = np.cov(random.normal(size=(4, 20)))
    # Independently: errors as vectors, seen in one frame and in the other.
    frames = []
    for vertical in (old_up, new_up):
        left = np.cross(vertical, direction)
        left /= np.linalg.norm(left)
        frames.append(np.stack((left, np.cross(direction, left))))
    offsets = frames[0].T @ np.eye(2)
    turn = np.zeros((4, 4))
    turn[:2, :2] = turn[2:, 2:] = frames[1] @ offsets
    got = turn_covariance(covariance, direction, old_up, new_up)
    assert np.allclose(got, turn @ covariance @ turn.T, atol=1e-12)
