from __future__ import annotations

import numpy as np
import pytest

from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.scenario import PipeModel


@pytest.fixture(params=[1, 2, 3])
def axis(request: pytest.FixtureRequest) -> PipeAxis:
    model = PipeModel(bend_radius=20.0, sag_radius=30.0)
    return PipeAxis.draw(model, -7.03, 18.3, np.random.default_rng(request.param))


def test_chainage_is_length(axis: PipeAxis) -> None:
    s = np.arange(axis.start, axis.end, 1e-3)
    steps = np.linalg.norm(np.diff(axis.points(s), axis=0), axis=1)
    assert np.abs(steps / 1e-3 - 1.0).max() < 1e-5


def test_the_origin_is_at_chainage_zero(axis: PipeAxis) -> None:
    assert np.abs(axis.points(0.0)).max() < 1e-9
    assert axis.tangents(0.0)[0] > 0.99


def test_bends_keep_to_the_least_radius(axis: PipeAxis) -> None:
    s = np.linspace(axis.start, axis.end, 2000)
    turn = np.linalg.norm(np.gradient(axis.tangents(s), s, axis=0), axis=1)
    assert turn.max() < 1.02 * np.hypot(1 / 20.0, 1 / 30.0)
    # And they do bend.
    assert turn.max() > 0.3 / 20.0


def test_frames_are_right_handed(axis: PipeAxis) -> None:
    tangent, right, up = axis.frames(np.linspace(-5, 15, 50))
    np.testing.assert_allclose(np.cross(tangent, up), right, atol=1e-12)
    assert np.abs(right[:, 2]).max() < 1e-12
    assert up[:, 2].min() > 0.99


def test_nearest_against_a_dense_search(axis: PipeAxis) -> None:
    rng = np.random.default_rng(0)
    places = np.stack([rng.uniform(-5, 15, 200), rng.uniform(-3, 3, 200)], axis=1)
    dense = np.arange(axis.start, axis.end, 1e-3)
    points = axis.points(dense)[:, :2]
    gap = np.linalg.norm(places[:, None] - points[None], axis=2)
    s, side = axis.nearest(places)
    assert np.abs(s - dense[gap.argmin(axis=1)]).max() < 0.02
    assert np.abs(np.abs(side) - gap.min(axis=1)).max() < 1e-3
    # Positive to port, and port is towards y for a pipe along x.
    clear = gap.min(axis=1) > 0.1
    above = places[:, 1] > points[gap.argmin(axis=1), 1]
    assert ((side > 0) == above)[clear].all()
