"""The echo sounder: a beam of some width whose first echo counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.raycaster import Caster
from pipeline_tracker.simulation.vehicle_models import SensorModel

Array = NDArray[np.float64]

# Rays spread evenly over the beam's section.
_RAYS = 48


class Altimeter:
    """Measures the way to what its beam meets first."""

    def __init__(self, model: SensorModel, caster: Caster, rng: np.random.Generator) -> None:
        """Prepare its beam.

        Args:
            model: noise, mounting, width of the beam, losses.
            caster: the scene.
            rng: random numbers.
        """
        self._model, self._caster, self._rng = model, caster, rng
        self._mounting = model.altimeter()
        self._beam = _cone(np.deg2rad(model.altimeter_beam_deg) / 2.0)

    def measure(self, base: Pose) -> float:
        """Return the range (m) with its noise, +inf where no echo comes back.

        Args:
            base: world <- base_link.
        """
        noise = self._model.altimeter_noise * self._rng.standard_normal()
        lost = self._rng.uniform() < self._model.altimeter_loss
        distance = self.true_range(base) + noise
        return np.inf if lost or distance > self._model.altimeter_reach else max(distance, 0.0)

    def true_range(self, base: Pose) -> float:
        """Return the way to what the beam meets first, m; +inf for nothing."""
        pose = base @ self._mounting
        ways = pose.rotate(self._beam).astype(np.float32)
        origins = np.tile(pose.translation.astype(np.float32), (len(ways), 1))
        hits = self._caster.nearest(origins, ways)
        return float(np.min(np.where(hits.mesh >= 0, hits.distance, np.inf)))


def _cone(half_angle: float) -> Array:
    """Return unit directions around x within an angle (rad), (N, 3)."""
    if half_angle <= 0.0:
        return np.array([[1.0, 0.0, 0.0]])
    n = np.arange(_RAYS)
    # A sunflower's spiral: equal areas.
    off, around = half_angle * np.sqrt((n + 0.5) / _RAYS), n * 2.399963
    return np.stack(
        [np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)], axis=1
    )
