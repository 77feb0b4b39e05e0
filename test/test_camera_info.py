"""Camera infos: what they say about images, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline_tracker.camera_info import (
    calibration_of,
    camera_from_info,
    is_rectified,
    is_whole_sensor,
    raw_camera_from_info,
)
from pipeline_tracker.errors import CalibrationError


def make(**changes: Any) -> SimpleNamespace:
    """Return a camera info of a right camera 0.2 m from the left, with distortion and a turn."""
    turn = 0.01
    fields = {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "d": [-0.2, 0.05, 0.001, -0.001, 0.0],
        "k": [500.0, 0, 322.0, 0, 505.0, 238.0, 0, 0, 1],
        "r": [np.cos(turn), 0, np.sin(turn), 0, 1, 0, -np.sin(turn), 0, np.cos(turn)],
        "p": [480.0, 0, 320.0, -96.0, 0, 480.0, 240.0, 0, 0, 0, 1, 0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
    }
    assert set(changes) <= set(fields)
    return SimpleNamespace(**fields | changes)


def window(x: int, y: int, width: int, height: int) -> SimpleNamespace:
    return SimpleNamespace(x_offset=x, y_offset=y, width=width, height=height)


def test_a_camera_that_needs_rectifying() -> None:
    info = make()
    raw = raw_camera_from_info(info)
    assert (raw.camera.fx, raw.camera.cx, raw.camera.offset) == (480.0, 320.0, 0.2)
    assert raw.matrix == tuple(info.k)
    assert raw.coefficients == tuple(info.d)
    assert raw.rotation == pytest.approx(info.r)
    assert not is_rectified(info)


@pytest.mark.parametrize(
    "changes",
    [
        {"d": [0.0] * 4 + [1e-3]},
        {"d": [0.1, 0.0, 0.0, 0.0], "distortion_model": "equidistant"},
        {"d": [], "r": make().r},
        {"d": [], "k": [500.0, 0, 320.0, 0, 480.0, 240.0, 0, 0, 1]},
    ],
)
def test_distortion_turn_or_another_matrix_need_rectifying(changes: dict[str, Any]) -> None:
    plain: dict[str, Any] = {
        "d": [],
        "r": np.eye(3).ravel(),
        "k": [480.0, 0, 320.0, 0, 480.0, 240.0, 0, 0, 1],
    }
    assert is_rectified(make(**plain))
    assert is_rectified(make(**plain | {"k": [0.0] * 9, "r": [0.0] * 9}))
    assert not is_rectified(make(**plain | changes))


def test_capitals_of_ros_1_are_read() -> None:
    info = make()
    old = SimpleNamespace(
        width=640, height=480, distortion_model="plumb_bob", D=info.d, K=info.k, R=info.r, P=info.p
    )
    assert raw_camera_from_info(old) == raw_camera_from_info(info)
    assert not is_rectified(old)
    assert calibration_of(old) == calibration_of(info)


@pytest.mark.parametrize("model", ["", "none", "plumb_bob"])
def test_without_distortion_the_model_does_not_matter(model: str) -> None:
    for d in ([], [0.0, 0.0]):
        raw = raw_camera_from_info(make(d=d, distortion_model=model))
        assert raw.model == "plumb_bob"
        assert raw.coefficients == (0.0,) * 5


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"d": [0.1, 0.2, 0.3]}, "right: D has 3 numbers, expected 5 or 4 for plumb_bob"),
        (
            {"distortion_model": "equidistant"},
            "right: D has 5 numbers, expected 4 for equidistant",
        ),
        (
            {"distortion_model": "rational_polynomial"},
            "D has 5 numbers, expected 8 or 12 or 14 for rational_polynomial",
        ),
        (
            {"distortion_model": "thin_prism"},
            "distortion_model is 'thin_prism', expected plumb_bob, rational_polynomial, equid",
        ),
        ({"d": [0.1, float("nan"), 0, 0, 0]}, "D has a number that is not finite"),
        ({"k": [0.0] * 9}, "K has focal lengths fx=0, fy=0, expected both above 0"),
        ({"k": [500.0, 0, 320.0]}, r"K has 3 numbers, expected 9"),
        ({"k": [500.0, 9, 1, 0, 500.0, 1, 0, 0, 1]}, "expected fx 0 cx 0 fy cy 0 0 1"),
        ({"r": [0.0] * 9}, "expected a rotation"),
        ({"r": [float("nan")] * 9}, "R has a number that is not finite"),
        ({"r": [1.0, 0, 0, 0, 1, 0, 0, 0, -1]}, "expected a rotation"),
        ({"p": [0.0] * 12}, "P has focal lengths fx=0, fy=0"),
        ({"p": [1.0] * 9}, "P has 9 numbers, expected 12"),
        ({"roi": window(600, 0, 100, 480)}, r"roi is 100 x 480 at \(600, 0\), expected a part of"),
        ({"binning_x": 1000}, "image size is 0 x 480"),
    ],
)
def test_what_is_refused_in_one_line(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(CalibrationError, match=f"^right: .*{text.removeprefix('right: ')}") as one:
        raw_camera_from_info(make(**changes), name="right")
    assert "\n" not in str(one.value)
    assert "calibrate" in str(one.value) or "driver" in str(one.value)


def test_binning_and_region_move_the_pixels() -> None:
    whole = camera_from_info(make())
    info = make(binning_x=2, binning_y=4, roi=window(100, 40, 400, 320))
    part = camera_from_info(info)
    assert (part.width, part.height) == (200, 80)
    assert part.offset == pytest.approx(whole.offset)
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 2.0], (20, 3))
    # A pixel of the image is the mean of 2 x 4 of the sensor: its centre lies between theirs.
    expected = (whole.project(points) - [100, 40] - [0.5, 1.5]) / [2, 4]
    np.testing.assert_allclose(part.project(points), expected, atol=1e-9)
    assert raw_camera_from_info(info).matrix[:3] == pytest.approx((250.0, 0.0, (322 - 100.5) / 2))
    assert not is_whole_sensor(info)
    assert is_whole_sensor(make())
    assert is_whole_sensor(make(binning_x=1, binning_y=1, roi=window(0, 0, 640, 480)))
    assert not is_whole_sensor(make(roi=window(0, 0, 640, 240)))


def test_infos_are_compared_by_what_counts() -> None:
    assert calibration_of(make()) == calibration_of(make())
    for change in (
        {"d": [-0.2, 0.05, 0.001, -0.001, 0.1]},
        {"k": [501.0, 0, 322.0, 0, 505.0, 238.0, 0, 0, 1]},
        {"r": np.eye(3).ravel()},
        {"binning_x": 2},
        {"roi": window(0, 0, 320, 240)},
        {"width": 641},
        {"distortion_model": "equidistant"},
    ):
        assert calibration_of(make()) != calibration_of(make(**change))
