"""The way between two pictures of one surface, and its compiled parts against plain ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.self_check.way import LEAST_AGREEMENT, Sight, _alike, _bilinear, seen_way
from pipeline_tracker.types import Image

Array = NDArray[np.float64]

CAMERA = Camera(900.0, 900.0, 599.5, 399.5, 1200, 800)
LEVEL = np.eye(3)[:2]
DEPTH = 2.0


def picture(at: Array) -> Image:
    """The thumbnail of a flat bed 2 m below a camera at x and y, m."""
    noise = np.random.default_rng(3).normal(0.0, 1.0, (400, 400)).astype(np.float32)
    bed = 120.0 + 150.0 * cv2.GaussianBlur(noise, (0, 0), 4.0)
    rows, columns = np.mgrid[0:100, 0:150].astype(np.float32)
    # A thumbnail's pixel shows 8 of the image; one of the bed's is 2 cm.
    scale = 8.0 * DEPTH / CAMERA.fx / 0.02
    found = cv2.remap(
        bed,
        np.float32(200.0 + at[0] / 0.02) + np.float32(scale) * (columns - 75.0),
        np.float32(200.0 + at[1] / 0.02) + np.float32(scale) * (rows - 50.0),
        cv2.INTER_LINEAR,
    )
    return np.clip(found, 0, 255).astype(np.uint8)


def before() -> Sight:
    pixels = np.random.default_rng(4).uniform([40.0, 40.0], [1160.0, 760.0], (400, 2))
    return Sight(DEPTH * CAMERA.rays(pixels), pixels, picture(np.zeros(2)), Pose.identity())


@pytest.mark.parametrize("told", [(0.3, 0.1), (0.27, 0.12), (-0.1, 0.3)])
def test_the_way_is_seen_whatever_is_told(told: tuple[float, float]) -> None:
    # The camera moves, and the bed the other way; the last one is only found by trying all.
    change = Pose(np.eye(3), np.array([-told[0], -told[1], 0.0]))
    found = seen_way(before(), picture(np.array([0.3, 0.1])), CAMERA, change, LEVEL)
    assert found is not None
    assert found[0] == pytest.approx([-0.3, -0.1, 0.0], abs=0.01)
    assert found[1] > LEAST_AGREEMENT


def test_pictures_that_have_nothing_in_common_do_not_agree() -> None:
    now = np.random.default_rng(5).integers(0, 255, (100, 150)).astype(np.uint8)
    change = Pose(np.eye(3), np.array([-0.3, 0.0, 0.0]))
    found = seen_way(before(), now, CAMERA, change, LEVEL)
    assert found is None or found[1] < LEAST_AGREEMENT


def test_a_surface_out_of_view_tells_nothing() -> None:
    change = Pose(np.eye(3), np.array([-6.0, 0.0, 0.0]))
    # A way of 6 m is tried up to 7 m: what is seen of that is no agreement.
    found = seen_way(before(), picture(np.array([6.0, 0.0])), CAMERA, change, LEVEL)
    assert found is None or found[1] < LEAST_AGREEMENT


def test_correlation_and_interpolation_agree_with_numpy_and_opencv() -> None:
    random = np.random.default_rng(6)
    a, b = random.normal(size=(2, 50))
    assert _alike(a, b) == pytest.approx(np.corrcoef(a, b)[0, 1])
    assert _alike(a, np.ones(50)) == -1.0
    image = random.normal(size=(20, 30)).astype(np.float32)
    # OpenCV rounds places to 1/32 px.
    x, y = random.integers(0, 28 * 32, 40) / 32.0, random.integers(0, 18 * 32, 40) / 32.0
    where = np.stack((x, y)).astype(np.float32)[:, None]
    expected = cv2.remap(image, where[0], where[1], cv2.INTER_LINEAR)[0]
    found = [_bilinear(image, column, row) for column, row in zip(x, y, strict=True)]
    assert found == pytest.approx(expected, abs=1e-5)
