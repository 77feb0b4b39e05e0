"""What is drawn of a frame: contours where they are, bands that hold 95 % of what may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline_tracker.axis_fit import across
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import contour_lines
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.report.shapes import frame_shapes, scaled
from pipeline_tracker.types import Contours, Mode, PipeSegment

LEFT = Camera(900.0, 900.0, 599.5, 399.5, 1200, 800)
RIGHT = replace(LEFT, offset=0.2)
MOUNTING = Pose.from_rpy([0.3, 0.1, -0.1], [-2.618, 0.0, -1.571])
UP = np.array([0.0, 0.0, 1.0])
SIGMAS = np.array([0.004, 0.010, 0.01, 0.02])


def segment(**changes: object) -> PipeSegment:
    start, end = np.array([0.9, 0.05, -2.2]), np.array([1.4, 0.1, -2.17])
    made = PipeSegment(
        stamp_ns=1,
        mode=Mode.TRACKING,
        technique=0,
        start=start,
        end=end,
        radius=0.3,
        covariance=np.diag(SIGMAS**2),
        support=0.5,
        visible_contours=Contours.LEFT_IMAGE_RIGHT | Contours.RIGHT_IMAGE_LEFT,
        contours=np.array([[1, 2, 3, 4], [5, 6, 7, 8]], np.float32),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def lines_of(middle: np.ndarray, way: np.ndarray, camera: Camera) -> list[np.ndarray]:
    to_optical = MOUNTING.inverse()
    lines = contour_lines(to_optical.apply(middle), to_optical.rotate(way), 0.3, camera)
    assert lines is not None
    return [line / np.linalg.norm(line[:2]) for line in lines]


def test_each_contour_is_seen_in_its_image() -> None:
    left, right = (frame_shapes(segment(), c, i, MOUNTING) for i, c in enumerate((LEFT, RIGHT)))
    assert left.contours[0].seen is None
    assert left.contours[1].seen == pytest.approx(np.array([[1, 2], [3, 4]]))
    assert right.contours[0].seen == pytest.approx(np.array([[5, 6], [7, 8]]))
    assert right.contours[1].seen is None
    assert left.contours[0].is_left
    assert not left.contours[1].is_left


@pytest.mark.parametrize("camera", [LEFT, RIGHT])
def test_expected_contours_lie_on_the_pipes_visible_edges(camera: Camera) -> None:
    found = segment()
    shapes = frame_shapes(found, camera, int(camera is RIGHT), MOUNTING)
    way = found.end - found.start
    lines = lines_of(0.5 * (found.start + found.end), way / np.linalg.norm(way), camera)
    for contour, line in zip(shapes.contours, lines, strict=True):
        assert contour.expected is not None
        assert contour.expected @ line[:2] + line[2] == pytest.approx([0.0, 0.0], abs=1e-6)
        # From border to border.
        inside = (contour.expected > -1.0).all() and (contour.expected < (1200.0, 800.0)).all()
        assert inside
        assert np.ptp(contour.expected[:, 1]) == pytest.approx(800.0, abs=1.0)
    assert shapes.axis is not None
    optical = MOUNTING.inverse().apply(np.stack((found.start, found.end)))
    assert shapes.axis == pytest.approx(camera.project(optical))


def test_band_holds_95_of_100_axes_that_may_be() -> None:
    found = segment()
    shapes = frame_shapes(found, LEFT, 0, MOUNTING)
    middle = 0.5 * (found.start + found.end)
    way = (found.end - found.start) / np.linalg.norm(found.end - found.start)
    left, up = across(way, UP)
    heading, pitch = np.arctan2(way[1], way[0]), np.arcsin(way[2])
    rng = np.random.default_rng(1)
    inside = np.zeros((2, 24))
    draws = 1500
    for aside, lift, turn, climb in rng.normal(0.0, 1.0, (draws, 4)) * SIGMAS:
        h, p = heading + turn, pitch + climb
        moved = np.array([np.cos(p) * np.cos(h), np.cos(p) * np.sin(h), np.sin(p)])
        for side, line in enumerate(lines_of(middle + aside * left + lift * up, moved, LEFT)):
            band = shapes.contours[side].band
            assert band is not None
            one, other = band[:24], band[::-1][:24]
            # The line passes between both borders of the band.
            signs = (one @ line[:2] + line[2]) * (other @ line[:2] + line[2])
            inside[side] += signs < 0.0
    share = inside / draws
    assert share.min() > 0.93
    assert share.max() < 0.97


def test_band_grows_away_from_the_segment() -> None:
    shapes = frame_shapes(segment(covariance=np.diag([1e-6, 1e-6, 1e-4, 1e-4])), LEFT, 0, MOUNTING)
    band = shapes.contours[0].band
    assert band is not None
    widths = np.linalg.norm(band[:24] - band[::-1][:24], axis=1)
    assert widths.argmin() not in (0, 23)
    assert widths[[0, -1]].min() > 2.0 * widths.min()


@pytest.mark.parametrize(
    "covariance", [np.zeros((4, 4)), np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0])]
)
def test_no_band_where_the_covariance_is_none(covariance: np.ndarray) -> None:
    shapes = frame_shapes(segment(covariance=covariance), LEFT, 0, MOUNTING)
    assert [c.band for c in shapes.contours] == [None, None]
    assert all(c.expected is not None for c in shapes.contours)


def test_what_is_not_in_view_is_not_drawn() -> None:
    behind = segment(start=np.array([0.0, 0.0, 3.0]), end=np.array([0.5, 0.0, 3.0]))
    shapes = frame_shapes(behind, LEFT, 0, MOUNTING)
    assert shapes.axis is None
    assert [c.expected for c in shapes.contours] == [None, None]
    around, step = MOUNTING.translation, np.array([0.1, 0.0, 0.0])
    inside = segment(start=around - step, end=around + step)
    assert [c.expected for c in frame_shapes(inside, LEFT, 0, MOUNTING).contours] == [None, None]
    point = frame_shapes(segment(end=segment().start), LEFT, 0, MOUNTING)
    assert point.axis is None
    assert [c.expected for c in point.contours] == [None, None]


def test_a_vertical_pipe_has_no_left_and_no_band() -> None:
    down = segment(start=np.array([1.3, 0.1, -2.5]), end=np.array([1.3, 0.1, -2.0]))
    assert [c.band for c in frame_shapes(down, LEFT, 0, MOUNTING).contours] == [None, None]


def test_shapes_in_a_smaller_image() -> None:
    shapes = frame_shapes(segment(), LEFT, 0, MOUNTING)
    small = shapes.scaled(0.5)
    # The corner of the picture stays the corner of the picture.
    assert scaled(np.array([-0.5, -0.5]), 0.5) == pytest.approx([-0.5, -0.5])
    assert scaled(np.array([1199.5, 799.5]), 0.5) == pytest.approx([599.5, 399.5])
    assert small.axis == pytest.approx(scaled(shapes.axis, 0.5))
    assert small.contours[1].seen == pytest.approx((shapes.contours[1].seen + 0.5) * 0.5 - 0.5)
    assert small.contours[0].seen is None
