"""Nearest neighbours in a picture, against a k-d tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline_tracker.geometry.neighbours import neighbours


@pytest.mark.parametrize(
    ("count", "size"),
    [(40, (1200.0, 800.0)), (1500, (1200.0, 800.0)), (300, (1200.0, 0.0)), (60, (0.0, 0.5))],
)
def test_they_are_those_of_a_tree(count: int, size: tuple[float, float]) -> None:
    random = np.random.default_rng(count)
    places = random.uniform(0.0, 1.0, (count, 2)) * size + [3.0, -7.0]
    # Crowded in one corner: cells differ much in what they hold.
    places[: count // 2] *= 0.1
    chosen = np.arange(0, count, 3)
    found = neighbours(places, chosen, 6)
    distances, _ = cKDTree(places).query(places[chosen], k=7)
    away = np.linalg.norm(places[found] - places[chosen, None], axis=2)
    assert np.allclose(away, distances[:, 1:])
    assert (found != chosen[:, None]).all()
    assert all(len(set(row)) == 6 for row in found.tolist())


def test_places_that_coincide_are_neighbours() -> None:
    places = np.zeros((8, 2))
    found = neighbours(places, np.arange(8), 6)
    assert all(len(set(row)) == 6 and k not in row for k, row in enumerate(found.tolist()))
