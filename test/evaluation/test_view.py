"""What is in view, and what is detectable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.contours import contours_from_message, is_detectable
from pipeline_tracker.evaluation.view import contours_in_view, sections
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import clip_line_to_view, visible_generatrices
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import header_message

CAMERA = Camera(930.0, 930.0, 599.5, 399.5, 1200, 800, offset=0.2)


@given(
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(1.0, 4.0),
    st.floats(-3.1, 3.1),
    st.floats(-0.7, 0.7),
    st.floats(0.05, 0.4),
)
def test_contours_of_a_straight_pipe_are_its_generatrices(
    x: float, y: float, z: float, azimuth: float, tilt: float, radius: float
) -> None:
    point = np.array([x, y, z])
    direction = np.array(
        [math.cos(azimuth) * math.cos(tilt), math.sin(azimuth) * math.cos(tilt), math.sin(tilt)]
    )
    edges = visible_generatrices(point, direction, radius, CAMERA.centre)
    t = np.linspace(-4.0, 4.0, 801)
    points = point + t[:, None] * direction
    seen = contours_in_view(points, np.tile(direction, (801, 1)), radius, CAMERA)
    if edges is None:
        assert not seen[:2].any()
        return
    for row, through in zip(seen, (*edges, point), strict=True):
        # t runs along the axis from `point`; the edges' points lie in another section.
        shift = float((through - point) @ direction)
        clipped = clip_line_to_view(through - shift * direction, direction, CAMERA)
        low, high = clipped or (math.inf, -math.inf)
        clear = (np.abs(t - low) > 1e-6) & (np.abs(t - high) > 1e-6)
        np.testing.assert_array_equal(row[clear], ((t > low) & (t < high))[clear])


def test_sections_are_close_together_and_on_the_polyline() -> None:
    line = np.array([[0.0, 0.0, 0.0], [0.52, 0.0, 0.0], [0.52, 0.0, 0.0], [0.52, 0.03, 0.04]])
    points, tangents = sections(line)
    np.testing.assert_allclose(points[0], line[0])
    np.testing.assert_allclose(points[-1], line[-1])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() <= 0.05 + 1e-12
    assert steps.sum() == pytest.approx(0.57)
    np.testing.assert_allclose(tangents[0], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(tangents[-1], [0.0, 0.6, 0.8])
    assert sections(np.zeros((1, 3)))[0].shape == (0, 3)


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        ("....", "....", False),
        ("hhhhh", "hhhhh", False),
        ("vvvvv", "hhhhh", True),
        ("hhhhh", "..vvv", True),
        # Half of the piece between hidden and visible counts: 1.5 of 6, 1.5 of 7.
        ("hhhhhvv", "", True),
        ("hhhhhhvv", "", False),
        # Two stretches in view, nothing between them.
        ("vv..hhhh", "", True),
        ("vv..hhhhh", "", False),
    ],
)
def test_a_quarter_of_one_contour_in_view_is_detectable(
    left: str, right: str, expected: bool
) -> None:
    size = max(len(left), len(right))
    flags = np.array(
        [[".hv".index(c) for c in row.ljust(size, ".")] for row in (left, right)], dtype=np.int64
    )
    pixels = np.zeros((2, size, 2))
    pixels[..., 1] = 10.0 * np.arange(size)
    pixels[flags == 0] = np.nan
    assert is_detectable(pixels, flags) == expected


def test_length_counts_not_the_number_of_points() -> None:
    # Far away the points lie close together: four visible pieces are a sixth of the length.
    y = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 70.0, 120.0])
    pixels = np.stack((np.zeros(7), y), axis=1)[None]
    flags = np.array([[2, 2, 2, 2, 2, 1, 1]])
    flags[0, 4] = 1
    assert not is_detectable(pixels, flags)
    assert is_detectable(pixels[:, ::-1], 3 - flags[:, ::-1])


def test_contours_of_the_simulator_are_read() -> None:
    pytest.importorskip("embreex")
    records = pytest.importorskip("pipeline_tracker.simulation.records")
    from pipeline_tracker.simulation.truth import Contours

    rng = np.random.default_rng(3)
    contours = Contours(
        np.arange(5.0),
        rng.normal(size=(2, 5, 3)),
        rng.uniform(0.0, 800.0, (2, 5, 2)),
        rng.integers(0, 3, (2, 5)).astype(np.uint8),
    )
    message = records.Messages(BagMessages()).contours(7, 0, contours).message
    pixels, flags = contours_from_message(message, "/contours")
    np.testing.assert_allclose(pixels, contours.pixels, rtol=1e-6)
    np.testing.assert_array_equal(flags, contours.flags)


def cloud(**changes: Any) -> Any:
    messages = BagMessages()
    names = changes.pop("names", ("u", "v", "flag"))
    fields = [
        messages.message("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate(names)
    ]
    values = {
        "height": 2,
        "width": 1,
        "point_step": 12,
        "row_step": 12,
        "data": np.zeros(24, np.uint8),
        **changes,
    }
    header = header_message(messages, 0, "left")
    return messages.message("sensor_msgs/msg/PointCloud2", header=header, fields=fields, **values)


def test_clouds_that_are_no_contours_are_refused() -> None:
    assert contours_from_message(cloud(), "/c")[1].shape == (2, 1)
    with pytest.raises(EvaluationError, match="no float32 field flag"):
        contours_from_message(cloud(names=("u", "v", "x")), "/c")
    with pytest.raises(EvaluationError, match="20 bytes of contours"):
        contours_from_message(cloud(data=np.zeros(20, np.uint8)), "/c")


def test_pose_of_the_camera_is_not_mistaken() -> None:
    # Tilted forward, from 2 m: the pipe ahead of the vehicle is in view, the one behind is not.
    mounting = Pose.from_rpy([0.0, 0.0, 0.0], [-math.pi + 0.6, 0.0, -math.pi / 2.0])
    base = Pose.from_rpy([0.0, 0.0, 2.0], [0.0, 0.0, 0.0])
    to_camera = (base @ mounting).inverse()
    along = np.array([[0.0, 1.0, 0.0]])
    for x, expected in ((1.3, True), (-1.3, False)):
        point = to_camera.apply([[x, 0.0, 0.0]])
        seen = contours_in_view(point, to_camera.rotate(along), 0.1, CAMERA)
        assert seen.all() == expected
        assert seen.any() == expected
