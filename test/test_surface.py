"""Matches triangulated, and how sure they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from synthetic_world import LEFT, MONO, RIG

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.surface import DISPARITY_SIGMA, disparity_sigma, triangulate


def seen(points: NDArray[np.float64], noise: float = 0.0, seed: int = 0) -> NDArray[np.float32]:
    """Matches (N, 4) of points in the left optical frame."""
    f, cx, cy, baseline = 930.0, 599.5, 399.5, 0.2
    x, y, z = points.T
    random = np.random.default_rng(seed)
    disparity = f * baseline / z + noise * random.normal(size=len(z))
    left = f * x / z + cx
    row = f * y / z + cy
    return np.column_stack((left, row, left - disparity, row)).astype(np.float32)


def some_points(count: int, seed: int = 1) -> NDArray[np.float64]:
    random = np.random.default_rng(seed)
    return random.uniform([-0.6, -0.4, 1.0], [0.6, 0.4, 4.0], (count, 3))


def test_exact_matches_give_their_points() -> None:
    points = some_points(50)
    surface = triangulate(seen(points), RIG)
    # float32 pixels: 6e-5 px of 46 px of disparity at 4 m.
    assert np.allclose(surface.points, points, atol=2e-5)
    lengths = np.linalg.norm(surface.rays, axis=1)
    assert np.allclose(lengths, 1.0)
    along = np.cross(surface.rays, points / np.linalg.norm(points, axis=1)[:, None])
    assert np.abs(along).max() < 1e-6
    assert np.allclose(surface.left_pixels, seen(points)[:, :2])
    assert np.allclose(surface.right_pixels, seen(points)[:, 2:])


def test_other_principal_points_are_taken_into_account() -> None:
    left, right = Camera(900.0, 900.0, 610.0, 390.0, 1200, 800), 0.15
    rig = StereoRig(left, Camera(900.0, 900.0, 580.0, 390.0, 1200, 800, offset=right))
    # (0.3, 0.1, 2.0): 900 * 0.15 + 610 and 900 * 0.075 + 580.
    match = np.array([[745.0, 435.0, 647.5, 435.0]], np.float32)
    assert np.allclose(triangulate(match, rig).points, [[0.3, 0.1, 2.0]])


def test_the_noise_of_a_disparity_becomes_that_of_a_depth() -> None:
    points = np.tile([0.1, 0.1, 3.0], (4000, 1))
    surface = triangulate(seen(points, DISPARITY_SIGMA), RIG)
    spread = float(np.linalg.norm(surface.points, axis=1).std())
    assert float(surface.depth_sigmas.mean()) == pytest.approx(spread, rel=0.1)


def test_no_disparity_is_no_point() -> None:
    matches = np.array(
        [[600, 400, 560, 400], [600, 400, 600, 400], [600, 400, 640, 400]], np.float32
    )
    surface = triangulate(matches, RIG)
    assert len(surface.points) == 1
    assert surface.points[0, 2] == pytest.approx(930.0 * 0.2 / 40.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -50.0, 1300.0])
@pytest.mark.parametrize("place", range(4))
def test_matches_outside_the_images_are_left_out(place: int, value: float) -> None:
    points = some_points(40)
    matches = seen(points)
    matches[7, place] = value
    surface = triangulate(matches, RIG)
    assert np.allclose(surface.points, np.delete(points, 7, axis=0), atol=2e-5)
    assert np.isfinite(surface.depth_sigmas).all()


def test_mono_and_no_matches_have_no_surface() -> None:
    for matches, rig in ((seen(some_points(5)), MONO), (np.zeros((0, 4), np.float32), RIG)):
        surface = triangulate(matches, rig)
        assert surface.points.shape == surface.rays.shape == (0, 3)
        assert surface.depth_sigmas.shape == (0,)


def test_the_noise_is_measured_on_the_frame() -> None:
    ys, xs = np.mgrid[16:800:32, 16:1200:32]
    pixels = np.column_stack((xs.ravel(), ys.ravel())).astype(np.float64)
    # A slanted plane: smooth disparities cost nothing.
    smooth = 60.0 + 0.01 * pixels[:, 0] + 0.005 * pixels[:, 1]
    random = np.random.default_rng(2)

    def measured(noise: float) -> float:
        shift = smooth + noise * random.normal(size=len(smooth))
        matches = np.column_stack((pixels[:, 0], pixels[:, 1], pixels[:, 0] - shift, pixels[:, 1]))
        return disparity_sigma(matches, LEFT.width)

    assert measured(0.0) == DISPARITY_SIGMA
    assert measured(0.1) == DISPARITY_SIGMA
    assert measured(2.0) == pytest.approx(2.0 * measured(1.0), rel=0.15)
    assert measured(1.0) > 1.5 * DISPARITY_SIGMA
    assert disparity_sigma(np.zeros((3, 4)), LEFT.width) == DISPARITY_SIGMA
    assert disparity_sigma(np.zeros((3, 4)), 3200) == 2.0 * DISPARITY_SIGMA


def test_few_or_poor_points_tell_no_shape() -> None:
    points = some_points(40)
    points[:, 2] = 2.0 + 0.05 * points[:, 0]
    good = triangulate(seen(points), RIG)
    assert good.tells_shape(0.3)
    assert not good.subset(np.arange(40) < 5).tells_shape(0.3)
    # 20 m away a depth is uncertain by more than a pipe is thick.
    far = triangulate(seen(points * 10.0), RIG)
    assert len(far.points) > 30
    assert not far.tells_shape(0.3)


def test_a_subset_keeps_what_belongs_together() -> None:
    surface = triangulate(seen(some_points(10)), RIG)
    part = surface.subset(surface.points[:, 0] > 0.0)
    assert 0 < len(part.points) < 10
    assert (part.points[:, 0] > 0.0).all()
    sizes = [len(a) for a in (part.rays, part.depth_sigmas, part.left_pixels, part.right_pixels)]
    assert sizes == [len(part.points)] * 4


def test_the_noise_agrees_with_a_plain_reference() -> None:
    random = np.random.default_rng(3)
    matches = np.column_stack((random.uniform([0, 0], [1200, 800], (700, 2)), np.zeros((700, 2))))
    bumpy = 60.0 + 8.0 * np.sin(0.02 * matches[:, 0]) + random.normal(0.0, 0.3, 700)
    matches[:, 2], matches[:, 3] = matches[:, 0] - bumpy, matches[:, 1]
    # Every second one, and the plane through the six nearest others.
    _, near = cKDTree(matches[:, :2]).query(matches[::2, :2], k=7)
    off = []
    for k, row in zip(range(0, 700, 2), near[:, 1:], strict=True):
        design = np.column_stack((np.ones(6), matches[row, :2] - matches[k, :2]))
        normal = design.T @ design + np.diag([1e-6, 1.0, 1.0])
        predicted = np.linalg.solve(normal, design.T @ bumpy[row])[0]
        leverage = 1.0 + np.linalg.inv(normal)[0, 0]
        off.append(abs(bumpy[k] - predicted) / np.sqrt(leverage))
    expected = DISPARITY_SIGMA * 1.4826 * float(np.median(off)) / 0.45
    assert expected > DISPARITY_SIGMA
    assert disparity_sigma(matches, LEFT.width) == pytest.approx(expected, rel=1e-6)
