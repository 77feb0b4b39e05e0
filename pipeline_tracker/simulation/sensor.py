"""From the light at the lens to an 8-bit image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.lens import lenses_of
from pipeline_tracker.simulation.scenario import Scenario

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Image = NDArray[np.uint8]

_GREY = np.array([[0.299, 0.587, 0.114]], np.float32)
_REFERENCE_ALBEDO = 0.3


@dataclass(frozen=True)
class Sensor:
    """A camera's lens and sensor; the same for both cameras of the pair.

    Attributes:
        scenario: for camera and water.
        gain: level of light 1 for red, green, blue, of full scale.
        fall_off: (H, W) float32, what vignetting leaves.
    """

    scenario: Scenario
    gain: Float32Array
    fall_off: Float32Array

    @classmethod
    def of(cls, scenario: Scenario, reference: Array) -> Sensor:
        """Expose for a grey surface on the bed ahead in the lamps' light ``reference`` (3,)."""
        camera = scenario.camera
        pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
        sight = lenses_of(camera)[0].sight(pixels.reshape(-1, 2).astype(np.float64))
        cosine = 1.0 / np.sqrt(1.0 + np.sum(sight**2, axis=1)).reshape(pixels.shape[:2])
        fall_off = 1.0 - camera.vignetting * (1.0 - cosine**4)
        exposure = camera.exposure / max(_REFERENCE_ALBEDO * float(reference[1]), 1e-12)
        gain = exposure * np.array(camera.white_balance)
        return cls(scenario, gain.astype(np.float32), fall_off.astype(np.float32))

    def expose(
        self, light: Float32Array, rng: np.random.Generator, brightness: float = 1.0
    ) -> Image:
        """Take an image.

        Args:
            light: (H, W, 3) float32, red, green, blue, before the lens.
            rng: random numbers for the noise.
            brightness: exposure of this image relative to the scenario's.

        Returns:
            (H, W, 3) blue, green, red, or (H, W), uint8, as ``camera.encoding`` says.
        """
        camera = self.scenario.camera
        level: Float32Array = self._blurred(light) * self.gain * self.fall_off[..., None]
        level *= np.float32(brightness)
        if camera.encoding == "mono8":
            level = np.asarray(cv2.transform(level, _GREY), np.float32)[..., None]
        electrons = camera.full_well * level
        sigma = np.sqrt(np.maximum(electrons, 0.0) + camera.read_noise**2)
        electrons += sigma * rng.standard_normal(electrons.shape, dtype=np.float32)
        level = np.clip(electrons / np.float32(camera.full_well), 0.0, 1.0)
        image = np.round(255.0 * level ** np.float32(1.0 / camera.gamma)).astype(np.uint8)
        grey = camera.encoding == "mono8"
        return np.ascontiguousarray(image[..., 0] if grey else image[..., ::-1])

    def _blurred(self, light: Float32Array) -> Float32Array:
        """Blur by the lens, and spread a share of the light to the water's halo."""
        camera, water = self.scenario.camera, self.scenario.water
        sharp = _gauss(light, camera.blur)
        if water.halo == 0.0:
            return sharp
        focal = camera.rig().left.fx
        wide = _gauss(light, float(np.tan(np.deg2rad(water.halo_deg))) * focal)
        return sharp + np.float32(water.halo) * (wide - sharp)


def _gauss(image: Float32Array, sigma: float) -> Float32Array:
    if sigma <= 0.0:
        return image
    blurred = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred, np.float32)
