from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.snow import Snow, draw_snow

FULL = ("water.snow=300", "camera.width=320", "camera.height=208")


@pytest.fixture(scope="module")
def snowing(small: Callable[..., Scenario]) -> Sea:
    return build_sea(small(*FULL))


def shine(sea: Sea, index: int, snow: Snow, distance: float = np.inf) -> NDArray[np.float64]:
    """Return what snow alone adds to a black image, green."""
    camera = sea.scenario.camera
    black = np.zeros((camera.height, camera.width, 3), np.float32)
    ranges = np.full(black.shape[:2], distance, np.float32)
    return sea.snow_views[index].over(black, ranges, snow)[..., 1].astype(np.float64)


def middle(image: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns = np.indices(image.shape)
    total = image.sum()
    return np.array([(columns * image).sum() / total, (rows * image).sum() / total])


@pytest.mark.parametrize("depth", [0.4, 1.0, 2.0, 3.5])
def test_a_particle_has_the_disparity_of_its_depth(snowing: Sea, depth: float) -> None:
    rig = snowing.scenario.camera.rig()
    place = np.array([[0.1, -0.02, depth]])
    snow = Snow(place, np.array([0.004]))
    seen = [middle(shine(snowing, n, snow)) for n in (0, 1)]
    # By hand, not by the code under test.
    left = [rig.left.cx + rig.left.fx * 0.1 / depth, rig.left.cy - rig.left.fy * 0.02 / depth]
    np.testing.assert_allclose(seen[0], left, atol=0.2)
    np.testing.assert_allclose(seen[1], left - np.array([rig.left.fx * 0.2 / depth, 0]), atol=0.2)


def test_near_particles_are_large_and_far_ones_small(snowing: Sea) -> None:
    sizes = []
    for depth in (0.25, 0.6, 2.0):
        image = shine(snowing, 0, Snow(np.array([[0.0, 0.0, depth]]), np.array([0.002])))
        sizes.append(int((image > 0).sum()))
    assert sizes[0] > sizes[1] > sizes[2] > 0


def test_what_is_nearer_hides_a_particle(snowing: Sea) -> None:
    snow = Snow(np.array([[0.0, 0.0, 2.0]]), np.array([0.004]))
    assert shine(snowing, 0, snow, distance=1.9).max() == 0.0
    assert shine(snowing, 0, snow, distance=2.1).max() > 0.0


def test_it_is_brighter_where_the_lamp_shines(snowing: Sea) -> None:
    near, far = (Snow(np.array([[0.0, 0.0, z]]), np.array([0.004])) for z in (0.8, 3.0))
    assert shine(snowing, 0, near).sum() > 5.0 * shine(snowing, 0, far).sum()


def test_the_particles_fill_the_water_evenly(small: Callable[..., Scenario]) -> None:
    snow = draw_snow(small("water.snow=2000"), np.random.default_rng(3))
    x, y, z = snow.places.T
    # In a box that the cameras see whole.
    for low in (1.5, 2.5):
        inside = (np.abs(x) < 0.5) & (np.abs(y) < 0.4) & (z > low) & (z < low + 1.0)
        assert inside.sum() == pytest.approx(2000 * 0.8, rel=0.15)
    assert np.median(snow.sizes) == pytest.approx(0.0012, rel=0.05)


def test_both_cameras_see_the_snow_of_their_moment(snowing: Sea) -> None:
    plain = snowing.renderer.render(snowing.motion.pose(0.0), 0)
    first, again, later = (snowing.picture(frame, 0) for frame in (0, 0, 1))
    assert np.array_equal(first.light, again.light)
    assert (first.light > plain.light * 1.02).any(axis=-1).sum() > 50
    assert np.array_equal(first.distance, plain.distance)
    assert np.array_equal(first.coverage, plain.coverage)
    assert not np.array_equal(first.light, later.light)
