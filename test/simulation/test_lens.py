"""Unrectified images: against OpenCV's models, and rectified by OpenCV against the truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.simulation import simulate
from pipeline_tracker.simulation.lens import Lens, lenses_of
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.simulator import build_sea

from .conftest import SMALL

Array = NDArray[np.float64]

MODELS = {
    "plumb_bob": "camera.distortion={coefficients: [-0.28, 0.09, 0.001, -0.0015, -0.012]}",
    "rational": "camera.distortion={model: rational_polynomial, "
    "coefficients: [0.3, 0.05, 0.0004, -0.0007, 0.004, 0.62, 0.13, 0.01]}",
    "equidistant": "camera.distortion={model: equidistant, "
    "coefficients: [-0.03, 0.01, -0.008, 0.001]}",
}


@pytest.fixture(params=MODELS)
def lenses(request: pytest.FixtureRequest, small: Callable[..., Scenario]) -> tuple[Lens, ...]:
    return lenses_of(small(MODELS[request.param]).camera)


def projected(lens: Lens, points: Array) -> Array:
    """Project points of the rectified frame by OpenCV."""
    rotation, _ = cv2.Rodrigues(lens.rotation.T)
    project: Any = cv2.fisheye.projectPoints if lens.model == "equidistant" else cv2.projectPoints
    found, _ = project(points[:, None], rotation, np.zeros(3), lens.matrix, lens.coefficients)
    return np.asarray(found).reshape(-1, 2)


def test_projection_is_that_of_opencv(lenses: tuple[Lens, ...]) -> None:
    points = np.random.default_rng(0).uniform([-0.5, -0.3, 0.9], [0.5, 0.3, 1.2], (200, 3))
    for lens in lenses:
        np.testing.assert_allclose(lens.project(points), projected(lens, points), atol=1e-8)


def test_rays_lead_back_to_their_pixels(lenses: tuple[Lens, ...]) -> None:
    pixels = np.random.default_rng(1).uniform([-0.5, -0.5], [191.5, 127.5], (500, 2))
    for lens in lenses:
        rays = lens.rays(pixels)
        np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
        np.testing.assert_allclose(projected(lens, rays), pixels, atol=1e-6)
        # Distortion, other matrices and turns: all well visible.
        moved = lens.camera.matrix @ rays.T
        assert np.abs((moved[:2] / moved[2]).T - pixels).max() > 3.0


def test_both_cameras_differ(lenses: tuple[Lens, ...]) -> None:
    left, right = lenses
    assert not np.allclose(left.rotation, right.rotation)
    assert not np.allclose(left.matrix, right.matrix)
    assert right.camera.offset == pytest.approx(0.2)


def test_without_distortion_a_lens_is_the_rectified_camera(small: Callable[..., Scenario]) -> None:
    for lens in lenses_of(small().camera):
        assert lens.rectified
        pixels = np.array([[0.0, 0.0], [95.5, 63.5], [191.0, 100.0]])
        rays = lens.camera.rays(pixels)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        np.testing.assert_allclose(lens.rays(pixels), rays, atol=1e-12)
        np.testing.assert_allclose(lens.project(rays), pixels, atol=1e-9)


# A pipe that hangs clear of the bed: nothing hides its contours.
CLEAR = ("bed.burial=-0.6", "bed.drifts=[]", "bed.stones=0", "bed.resolution=0.1")
SIZE = ("camera.width=480", "camera.height=320")


def silhouette(coverage: Array, rows: range) -> Array:
    """Return where the pipe begins and ends in rows, px, from the covered length: (N, 2)."""
    edges = []
    for row in rows:
        line = coverage[row]
        middle = int(np.sum(line * np.arange(len(line))) / np.sum(line))
        within, beyond = line[: middle + 1].sum(), line[middle + 1 :].sum()
        edges.append((middle + 0.5 - within, middle + 0.5 + beyond))
    return np.array(edges)


@pytest.mark.parametrize("model", MODELS)
def test_rectifying_by_opencv_gives_the_rectified_silhouette(
    small: Callable[..., Scenario], model: str
) -> None:
    true = build_sea(small(*CLEAR, *SIZE))
    raw = build_sea(small(*CLEAR, *SIZE, MODELS[model]))
    base = true.motion.pose(0.0)
    for index, lens in enumerate(lenses_of(raw.scenario.camera)):
        rectify: Any = (
            cv2.fisheye.initUndistortRectifyMap
            if lens.model == "equidistant"
            else cv2.initUndistortRectifyMap
        )
        size = (480, 320)
        p = lens.camera.matrix
        maps = rectify(lens.matrix, lens.coefficients, lens.rotation, p, size, cv2.CV_32FC1)
        drawn = raw.renderer.render(base, index).coverage
        rectified = cv2.remap(drawn, *maps, cv2.INTER_LINEAR).astype(np.float64)
        expected = true.renderer.render(base, index).coverage.astype(np.float64)
        rows = range(30, 290)
        found, wanted = silhouette(rectified, rows), silhouette(expected, rows)
        # It is really another image.
        assert np.abs(silhouette(drawn.astype(np.float64), rows) - wanted).max() > 3.0
        off = found - wanted
        # OpenCV's interpolation errs by a share of a pixel from row to row, not over ten of them.
        assert np.abs(off).max() < 0.3
        assert np.abs(off.reshape(-1, 10, 2).mean(axis=1)).max() < 0.1
        assert np.abs(off.mean(axis=0)).max() < 0.03


def test_the_bag_is_unrectified_by_the_conventions(tmp_path: Path) -> None:
    bag = simulate("demo", tmp_path / "raw", [*SMALL, "frames=1", MODELS["plumb_bob"]], 1, False)
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        read = {c.topic: store.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages()}
    assert "/stereo/left/image_raw/compressed" in read
    assert not [topic for topic in read if "image_rect" in topic]
    lenses = lenses_of(load_scenario("demo", [*SMALL, MODELS["plumb_bob"]]).camera)
    for side, lens in zip(("left", "right"), lenses, strict=True):
        info = read[f"/stereo/{side}/camera_info"]
        assert info.distortion_model == "plumb_bob"
        assert info.d.tolist() == [-0.28, 0.09, 0.001, -0.0015, -0.012]
        np.testing.assert_array_equal(info.k.reshape(3, 3), lens.matrix)
        np.testing.assert_array_equal(info.r.reshape(3, 3), lens.rotation)
        np.testing.assert_array_equal(info.p.reshape(3, 4)[:, :3], lens.camera.matrix)
    # The truth's pixels are those of the rectified image.
    cloud = read["/ground_truth/contours/left"]
    data = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 7)
    seen = data[:, 6] > 0
    pixels = lenses[0].camera.project(data[seen, :3].astype(float))
    np.testing.assert_allclose(pixels, data[seen, 3:5], atol=1e-2)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.distortion={coefficients: [0.1, 0.1]}", ["plumb_bob has 5", "got 2"]),
        ("camera.distortion={model: thin}", ["camera.distortion.model='thin'", "'plumb_bob'"]),
        ("camera.distortion={coefficients: [0, 0, .nan, 0, 0]}", ["coefficients.2", "finite"]),
        ("camera.distortion={focal_share: 0}", ["focal_share=0"]),
        ("camera.distortion={turn: 1}", ["camera.distortion.turn=1", "unknown key"]),
    ],
)
def test_impossible_lenses_are_refused(override: str, words: list[str]) -> None:
    with pytest.raises(SettingsError) as refused:
        load_scenario("demo", [override])
    assert "\n" not in str(refused.value)
    for word in words:
        assert word in str(refused.value)


def test_a_lens_that_folds_the_image_is_refused(small: Callable[..., Scenario]) -> None:
    folded = small("camera.distortion={coefficients: [-0.9, 0, 0, 0, 0]}")
    with pytest.raises(SettingsError, match=r"without a direction of its own.*choose weaker"):
        lenses_of(folded.camera)
