from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.altimeter import Altimeter
from pipeline_tracker.simulation.meshes import Mesh
from pipeline_tracker.simulation.raycaster import RayCaster
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.simulator import Sea
from pipeline_tracker.simulation.vehicle_models import SensorModel


@pytest.fixture(scope="module")
def floor() -> RayCaster:
    """A level floor at z = 0 for x below 1 m, a step of 0.5 m up beyond."""
    low = [[-50, -50, 0], [1, -50, 0], [1, 50, 0], [-50, 50, 0]]
    high = [[1, -50, 0.5], [50, -50, 0.5], [50, 50, 0.5], [1, 50, 0.5]]
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    return RayCaster({0: Mesh(np.array(low + high, np.float32), faces)})


def altimeter(floor: RayCaster, seed: int = 0, **values: object) -> Altimeter:
    model = SensorModel.model_validate({"altimeter_noise": 0.0, **values})
    return Altimeter(model, floor, np.random.default_rng(seed))


def at(height: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    return Pose.from_rpy([0.0, 0.0, height], rpy)


def test_a_thin_beam_goes_straight_down_in_base_link(floor: RayCaster) -> None:
    thin = altimeter(floor, altimeter_beam_deg=0.0)
    assert thin.measure(at(3.0)) == pytest.approx(3.0, abs=1e-5)
    # Rolled with the vehicle: the way along the tilted beam.
    rolled = thin.measure(at(3.0, (0.2, 0.0, 0.7)))
    assert rolled == pytest.approx(3.0 / np.cos(0.2), abs=1e-5)


def test_its_mounting_is_that_of_the_scenario(floor: RayCaster) -> None:
    aside = altimeter(
        floor,
        altimeter_beam_deg=0.0,
        altimeter_translation=(2.0, 0.0, -0.3),
        altimeter_direction=(-1.0, 0.0, -2.0),
    )
    # From (2, 0, 2.7) aft and down: the step at x = 1 is met at z = 0.7, the floor at x = 0.65.
    assert aside.measure(at(3.0)) == pytest.approx(2.7 * np.sqrt(1.25), abs=1e-4)


@pytest.mark.parametrize("direction", [(0, 0, -1), (1, 0, 0), (0, 3, 0), (0.2, -0.4, -0.8)])
def test_the_beam_is_along_x_of_its_own_frame(direction: tuple[float, float, float]) -> None:
    pose = SensorModel(altimeter_direction=tuple(map(float, direction))).altimeter()
    expected = np.array(direction) / np.linalg.norm(direction)
    np.testing.assert_allclose(pose.rotation[:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


def test_the_first_echo_of_a_wide_beam_counts(floor: RayCaster) -> None:
    # 3 m up, the step is 1 m away: 21.8 degrees off.
    narrow = altimeter(floor, altimeter_beam_deg=30.0).measure(at(3.0))
    assert narrow == pytest.approx(3.0, rel=0.01)
    wide = altimeter(floor, altimeter_beam_deg=55.0).measure(at(3.0))
    assert wide == pytest.approx(2.5 / np.cos(np.arctan2(1.0, 2.5)), rel=0.03)


def test_noise_losses_and_reach(floor: RayCaster) -> None:
    noisy = altimeter(floor, altimeter_noise=0.05, altimeter_loss=0.2)
    ranges = np.array([noisy.measure(at(3.0)) for _ in range(2000)])
    heard = np.isfinite(ranges)
    assert 0.16 < 1.0 - heard.mean() < 0.24
    assert ranges[heard].std() == pytest.approx(0.05, rel=0.1)
    assert np.isposinf(ranges[~heard]).all()
    assert altimeter(floor, altimeter_reach=2.9).measure(at(3.0)) == np.inf
    assert altimeter(floor).measure(at(3.0, (np.pi, 0.0, 0.0))) == np.inf


def test_it_sees_the_pipe_below(sea: Sea, small: Callable[..., Scenario]) -> None:
    # Straight above the axis: down to the pipe's top.
    place = sea.scene.axis.points(1.0) + np.array([0.0, 0.0, 2.0])
    model = small("sensors.altimeter_noise=0", "sensors.altimeter_beam_deg=0").sensors
    above = Altimeter(model, sea.scene.caster, np.random.default_rng(0))
    assert above.measure(Pose(np.eye(3), place)) == pytest.approx(1.7, abs=0.01)
