"""Cameras and what is refused as a calibration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.errors import CalibrationError
from pipeline_tracker.geometry.camera import Camera, camera_from_projection, stereo_rig

LEFT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800)
RIGHT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800, offset=0.2)


def projection(**changes: float) -> NDArray[np.float64]:
    """P of the right camera, with single elements changed ("r0c3" is P[0, 3])."""
    p = np.array([[930.0, 0, 600.5, -186.0], [0, 925.0, 399.5, 0], [0, 0, 1, 0]])
    for name, value in changes.items():
        p[int(name[1]), int(name[3])] = value
    return p


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.1, 20))
def test_projection_is_that_of_the_full_matrix(x: float, y: float, z: float) -> None:
    homogeneous = projection() @ [x, y, z, 1.0]
    np.testing.assert_allclose(
        RIGHT.project([x, y, z]), homogeneous[:2] / homogeneous[2], rtol=1e-12, atol=1e-9
    )


@given(st.floats(0, 1200), st.floats(0, 800), st.floats(0.1, 20))
def test_a_ray_is_seen_in_its_pixel(u: float, v: float, depth: float) -> None:
    point = RIGHT.centre + depth * RIGHT.rays([u, v])
    np.testing.assert_allclose(RIGHT.project(point), [u, v], atol=1e-8)


def test_a_point_before_the_camera_has_a_disparity_of_focal_length_by_baseline_by_depth() -> None:
    rig = stereo_rig(LEFT, RIGHT)
    left, right = (camera.project([0.3, 0.1, 2.0]) for camera in rig.cameras)
    assert left[0] - right[0] == pytest.approx(930.0 * 0.2 / 2.0)
    assert left[1] == right[1]


def test_camera_of_a_projection_matrix() -> None:
    assert camera_from_projection(projection(), 1200, 800) == RIGHT
    assert camera_from_projection(projection().ravel(), 1200, 800) == RIGHT


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"r0c0": math.nan}, "not finite"),
        ({"r0c0": 0.0}, "fx=0"),
        ({"r1c1": -5.0}, "fy=-5"),
        ({"r0c1": 3.0}, "not that of a rectified camera"),
        ({"r1c3": 20.0}, "not that of a rectified camera"),
        ({"r2c2": 2.0}, "not that of a rectified camera"),
    ],
)
def test_an_impossible_projection_is_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(CalibrationError, match=f"right camera_info.*{text}"):
        camera_from_projection(projection(**changes), 1200, 800, name="right camera_info")


def test_an_empty_calibration_is_refused() -> None:
    with pytest.raises(CalibrationError, match="fx=0"):
        camera_from_projection(np.zeros(12), 1200, 800)
    with pytest.raises(CalibrationError, match="0 x 800"):
        camera_from_projection(projection(), 0, 800)


def test_a_rig_knows_its_baseline() -> None:
    assert stereo_rig(LEFT, RIGHT).baseline == 0.2
    assert stereo_rig(LEFT, None).baseline == 0.0
    assert stereo_rig(LEFT, None).cameras == (LEFT,)


@pytest.mark.parametrize(
    ("left", "right", "text"),
    [
        (RIGHT, LEFT, "left and right swapped"),
        (LEFT, LEFT, "baseline of 0 m"),
        (LEFT, Camera(930.0, 925.0, 600.5, 399.5, 1200, 800, offset=-0.2), "baseline of -0.2"),
        (LEFT, Camera(930.0, 925.0, 600.5, 399.5, 1200, 600, offset=0.2), "differ in size"),
        (LEFT, Camera(930.0, 925.0, 600.5, 405.5, 1200, 800, offset=0.2), "rows do not agree"),
        (LEFT, Camera(930.0, 950.0, 600.5, 399.5, 1200, 800, offset=0.2), "rows do not agree"),
    ],
)
def test_what_is_no_rectified_pair_is_refused(left: Camera, right: Camera, text: str) -> None:
    with pytest.raises(CalibrationError, match=text):
        stereo_rig(left, right)
