"""Rectified images against what a pinhole camera would have seen, by inverse formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from bag_maker import FACTORY, LEFT, START, raw_image
from numpy.typing import NDArray

from pipeline_tracker import messages, rectification
from pipeline_tracker.errors import CalibrationError, ImageError
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.rectification import StereoImages
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import settings_from_values
from pipeline_tracker.simulation.distortion import undistort

Array = NDArray[np.float64]

CAMERA = Camera(190.0, 200.0, 118.0, 83.0, 240, 160)
TURN = Pose.from_rpy(np.zeros(3), [0.01, -0.02, 0.015]).rotation
MATRIX = np.array([[185.0, 0.0, 121.0], [0.0, 186.0, 78.0], [0.0, 0.0, 1.0]])
MODELS = {
    "plumb_bob": [-0.28, 0.09, 0.001, -0.0015, -0.012],
    "rational_polynomial": [0.3, 0.05, 0.0004, -0.0007, 0.004, 0.62, 0.13, 0.01],
    "equidistant": [-0.03, 0.01, -0.008, 0.001],
}


def settings(**values: Any) -> Settings:
    return settings_from_values({"pipe.diameter": 0.6, "camera.rectify": True} | values)


def info(model: str = "plumb_bob", camera: Camera = CAMERA, **changes: Any) -> Any:
    """Return a camera info of a lens before a pinhole."""
    message = messages.camera_info_message(FACTORY, camera, START, "left")
    fields: dict[str, Any] = {
        "distortion_model": model,
        "d": np.array(MODELS.get(model, [])),
        "k": MATRIX.ravel(),
        "r": TURN.ravel(),
    }
    return replace(message, **fields | changes)


def undistorted(model: str, pixels: Array) -> Array:
    """Return where pixels (N, 2) of the camera look: x and y at z = 1, rectified frame."""
    bent = (pixels - MATRIX[:2, 2]) / MATRIX[[0, 1], [0, 1]]
    sight = undistort(bent, model == "equidistant", np.array(MODELS[model]))
    turned = np.concatenate((sight, np.ones((len(sight), 1))), axis=1) @ TURN.T
    return turned[:, :2] / turned[:, 2:]


def grid(camera: Camera) -> Array:
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    return np.stack((xs.ravel(), ys.ravel()), axis=1)


def scene(sight: Array) -> Array:
    """Return the brightness in directions (N, 2): waves, 10 to 40 px long."""
    x, y = sight.T
    waves = np.sin(30.0 * x + 20.0 * y) + np.sin(70.0 * y - 25.0 * x) + np.sin(90.0 * x)
    return 128.0 + 40.0 * waves


def seen(sight: Array) -> Any:
    grey = np.clip(np.rint(scene(sight)), 0, 255).astype(np.uint8)
    return raw_image(START, grey.reshape(CAMERA.height, CAMERA.width))


@pytest.mark.parametrize("model", MODELS)
def test_an_image_is_what_a_pinhole_would_have_seen(model: str) -> None:
    images = StereoImages(settings(), info(model))
    found = images.read(seen(undistorted(model, grid(CAMERA))), "left").ravel()
    wanted = scene(CAMERA.rays(grid(CAMERA))[:, :2])
    whole = np.ones(len(found), bool)
    if images.unseen.left is not None:
        whole = ~images.unseen.left.grown(1, 2).ravel()
    assert whole.mean() > 0.8
    off = found[whole] - wanted[whole]
    assert np.abs(off).max() < 8.0
    assert np.sqrt(np.mean(off**2)) < 1.5
    # It is really another image.
    assert np.abs(scene(undistorted(model, grid(CAMERA))) - wanted).mean() > 20.0


def test_unseen_is_what_the_camera_does_not_reach() -> None:
    camera = replace(CAMERA, fx=120.0, fy=120.0)
    images = StereoImages(settings(), info(camera=camera))
    rays = camera.rays(grid(camera))
    turned, _ = cv2.Rodrigues(TURN.T)
    model = np.array(MODELS["plumb_bob"])
    places = cv2.projectPoints(rays[:, None], turned, np.zeros(3), MATRIX, model)[0]
    x, y = np.asarray(places).reshape(-1, 2).T
    inside = (x >= 0) & (x <= 239) & (y >= 0) & (y <= 159)
    assert images.unseen.left is not None
    wrong = images.unseen.left.mask.ravel() == inside
    # The very border may fall to either side by rounding.
    assert wrong.mean() < 1e-3
    assert 0.2 < images.unseen.left.mask.mean() < 0.7
    # Where nothing was seen, the border goes on: no level that the image does not have.
    grey = raw_image(START, np.full((160, 240), 77, np.uint8))
    assert set(np.unique(images.read(grey, "left"))) == {77}


def test_a_camera_that_sees_all_has_nothing_unseen() -> None:
    camera = replace(CAMERA, fx=260.0, fy=260.0)
    assert StereoImages(settings(), info(camera=camera)).unseen.left is None


def test_without_the_setting_images_stay_as_they_are() -> None:
    images = StereoImages(settings(**{"camera.rectify": False}), info())
    message = seen(undistorted("plumb_bob", grid(CAMERA)))
    np.testing.assert_array_equal(images.read(message, "left").ravel(), message.data)
    assert images.infos_hold
    assert images.unseen == (None, None)


def test_infos_do_not_describe_what_was_rectified_or_cut() -> None:
    assert not StereoImages(settings(), info()).infos_hold
    binned = info(binning_x=2, binning_y=2)
    images = StereoImages(settings(**{"camera.rectify": False}), binned)
    assert (images.rig.left.width, images.rig.left.height) == (120, 80)
    assert not images.infos_hold


def test_each_side_has_its_own_maps() -> None:
    right = replace(CAMERA, offset=0.2)
    images = StereoImages(settings(), info(), info("equidistant", right))
    assert images.rig.baseline == pytest.approx(0.2)
    wanted = scene(CAMERA.rays(grid(CAMERA))[:, :2]).reshape(160, 240)
    for side, model in (("left", "plumb_bob"), ("right", "equidistant")):
        found = images.read(seen(undistorted(model, grid(CAMERA))), side)
        middle = (slice(40, 120), slice(60, 180))
        assert np.abs(found[middle] - wanted[middle]).max() < 8.0


def test_maps_are_made_once_for_infos_that_say_the_same() -> None:
    rectification._maps.cache_clear()
    for stamp in range(5):
        header = messages.header_message(FACTORY, stamp, "left")
        StereoImages(settings(), info(header=header), info(camera=replace(CAMERA, offset=0.2)))
    assert rectification._maps.cache_info().misses == 2
    for focal in range(5):
        StereoImages(settings(), info(camera=replace(CAMERA, fx=200.0 + focal)))
    assert rectification._maps.cache_info().currsize == 2


def test_an_image_of_another_size_is_refused() -> None:
    images = StereoImages(settings(), info())
    message = raw_image(START, np.zeros((48, 64), np.uint8))
    with pytest.raises(ImageError, match="right image: image is 64 x 48, expected 240 x 160"):
        images.read(message, "right")


@pytest.mark.parametrize("size", [(40_000, 10), (9_000, 9_000)])
def test_maps_of_huge_size_are_refused_before_they_are_made(size: tuple[int, int]) -> None:
    camera = replace(LEFT, width=size[0], height=size[1])
    with pytest.raises(CalibrationError, match=f"left camera_info: image size is {size[0]} x"):
        StereoImages(settings(), info(camera=camera))


def test_a_calibration_of_another_camera_is_refused() -> None:
    off = MATRIX.copy()
    off[0, 2] += 900.0
    with pytest.raises(CalibrationError, match="only 0 % of the rectified picture come from"):
        StereoImages(settings(), info(k=off.ravel()))
