"""The model of a scenario: everything that a simulated sea is made from.

Strict as the settings are: unknown keys, values out of range and values of another type are
refused. Angles carry ``_deg`` in their name where they are degrees; ``camera.translation`` and
``camera.rotation_rpy`` mean what they mean in the settings (metres, radians).
"""

from __future__ import annotations

import numpy as np
from pydantic import field_validator, model_validator

from pipeline_tracker.settings import Section, Vector
from pipeline_tracker.simulation.object_models import (
    FishModel,
    LedgeModel,
    TubeModel,
    WeedModel,
)
from pipeline_tracker.simulation.scenario_values import Coefficients, Colour, value
from pipeline_tracker.simulation.vehicle_models import (
    CameraModel,
    PathModel,
    SensorModel,
    VnmModel,
)


class PipeModel(Section):
    """The pipe."""

    present: bool = value(True, "Whether there is a pipe; the vehicle follows its axis in any case")
    diameter: float = value(0.6, "Outer diameter", unit="m", gt=0.02, le=10)
    bend_radius: float = value(45.0, "Least radius of the bends sideways", unit="m", ge=3, le=1e6)
    bend_length: float = value(16.0, "Length of a bend to port and one back", unit="m", ge=2)
    sag_radius: float = value(70.0, "Least radius of the bends upward", unit="m", ge=3, le=1e6)
    sag_length: float = value(9.0, "Length of a rise and a fall", unit="m", ge=2)
    curve_radius: float | None = value(
        None, "Radius of a steady bend to port (negative: to starboard); null: none", unit="m"
    )
    slope_deg: float = value(0.0, "Steady climb, the bed with it", unit="deg", ge=-30, le=30)
    joint_spacing: float = value(6.0, "Way between field joints", unit="m", gt=0.5)
    colour: Colour = value((0.22, 0.22, 0.20), "Share of light returned: red, green, blue")
    texture: float = value(0.5, "Contrast of the surface", ge=0, le=2)
    growth: float = value(0.3, "Share of the surface under growth", ge=0, le=1)
    damage: float = value(0.0, "Share of the surface that has lost its coating", ge=0, le=1)
    sediment: float = value(0.3, "Share of the upper side dusted with sediment", ge=0, le=1)

    @field_validator("curve_radius")
    @classmethod
    def _is_no_coil(cls, radius: float | None) -> float | None:
        if radius is not None and abs(radius) < 3.0:
            raise ValueError("expected at least 3 either way, or null for no steady bend")
        return radius


class DriftModel(Section):
    """A heap of silt on the bed, which may cover a part of the pipe."""

    at: float = value(..., "Chainage of its middle", unit="m")
    offset: float = value(0.0, "Its middle to port of the axis", unit="m", ge=-20, le=20)
    length: float = value(1.0, "Extent along the pipe (one sigma)", unit="m", gt=0.05, le=100)
    width: float = value(0.5, "Extent across the pipe (one sigma)", unit="m", gt=0.05, le=100)
    height: float = value(0.3, "Height above the bed around it", unit="m", ge=0, le=5)


class BedModel(Section):
    """The bed, a height field with stones."""

    burial: float = value(0.15, "Share of the diameter below the bed", ge=-1, le=1.5)
    burial_variation: float = value(0.08, "How much that varies along the pipe", ge=0, le=1)
    relief: float = value(0.12, "Height of the large undulations", unit="m", ge=0, le=3)
    relief_length: float = value(3.0, "Length of the large undulations", unit="m", ge=0.3, le=100)
    roughness: float = value(0.02, "Height of the small unevenness", unit="m", ge=0, le=0.3)
    ripple_height: float = value(0.012, "Height of sand ripples", unit="m", ge=0, le=0.2)
    ripple_length: float = value(0.22, "Length of sand ripples", unit="m", ge=0.08, le=5)
    stones: float = value(0.7, "Stones on a square metre", unit="1/m²", ge=0, le=20)
    stone_size: float = value(0.07, "Median size of a stone", unit="m", gt=0.01, le=2)
    resolution: float = value(0.025, "Spacing of the height field", unit="m", ge=0.005, le=0.5)
    colour: Colour = value((0.33, 0.30, 0.24), "Share of light returned: red, green, blue")
    texture: float = value(0.6, "Contrast of the surface", ge=0, le=2)
    drifts: tuple[DriftModel, ...] = value((), "Heaps of silt", max_length=100)


class LampModel(Section):
    """A lamp fixed to the vehicle."""

    position: Vector = value((0.4, -0.3, -0.1), "Position in base_link", unit="m")
    direction: Vector = value((0.5, 0.1, -1.0), "Direction of the beam in base_link")
    half_angle_deg: float = value(
        45.0, "Angle off the beam's axis where half its strength is left", unit="deg", gt=1, le=120
    )
    power: float = value(1.0, "Strength relative to the other lamps", gt=0, le=1000)
    radius: float = value(0.04, "Radius of the lamp; larger gives softer shadows", unit="m", ge=0)
    colour: Colour = value((1.0, 1.0, 1.0), "Red, green, blue")

    @model_validator(mode="after")
    def _has_direction(self) -> LampModel:
        if float(np.linalg.norm(self.direction)) < 1e-6:
            raise ValueError("direction is a zero vector; give it a length")
        return self


class WaterModel(Section):
    """What the water does to light."""

    attenuation: Coefficients = value(
        (0.38, 0.14, 0.17), "Light lost on each metre: red, green, blue", unit="1/m"
    )
    backscatter: Coefficients = value(
        (0.010, 0.014, 0.013), "Light scattered back on each metre: red, green, blue", unit="1/m"
    )
    halo: float = value(0.25, "Share of light scattered forward into a halo", ge=0, le=0.95)
    halo_deg: float = value(0.5, "Width of that halo (one sigma)", unit="deg", gt=0, le=10)
    snow: float = value(
        0.0, "Particles of marine snow in a cubic metre", unit="1/m³", ge=0, le=20_000
    )
    snow_size: float = value(0.0012, "Median size of a particle", unit="m", gt=0, le=0.02)
    ambient: float = value(
        0.04, "Light from above, relative to the lamps' on the bed ahead", ge=0, le=100
    )


class Scenario(Section):
    """A whole scenario."""

    description: str = value("", "What is in it, in one line")
    frames: int = value(20, "Number of stereo pairs", ge=1, le=100_000)
    stretch: float = value(
        0.0,
        "Way along the pipe for which the sea is made at least; fewer frames see the same sea",
        unit="m",
        ge=0,
        le=10_000,
    )
    seed: int = value(1, "Another seed: another bed, texture, path and noise", ge=0, lt=2**63)
    pipe: PipeModel = PipeModel()
    bed: BedModel = BedModel()
    tubes: tuple[TubeModel, ...] = value((), "Cables and further pipes", max_length=30)
    ledges: tuple[LedgeModel, ...] = value((), "Straight edges of rock", max_length=30)
    weed: WeedModel = WeedModel()
    fish: FishModel = FishModel()
    lamps: tuple[LampModel, ...] = value((LampModel(),), "Lamps", min_length=1, max_length=16)
    water: WaterModel = WaterModel()
    camera: CameraModel = CameraModel()
    path: PathModel = PathModel()
    vnm: VnmModel = VnmModel()
    sensors: SensorModel = SensorModel()

    @model_validator(mode="after")
    def _dropouts_within_the_run(self) -> Scenario:
        end = (self.frames - 1) * self.path.period
        for key, dropouts in (
            ("vnm.dropouts", self.vnm.dropouts),
            ("sensors.altimeter_dropouts", self.sensors.altimeter_dropouts),
        ):
            for index, dropout in enumerate(dropouts):
                if dropout.at > end:
                    raise ValueError(
                        f"{key}.{index}.at={dropout.at:g} s lies after the last pair at {end:g} s; "
                        "expected a time within the run (frames, path.period)"
                    )
        return self

    @property
    def radius(self) -> float:
        """The pipe's radius, m."""
        return self.pipe.diameter / 2.0

    @property
    def way(self) -> float:
        """The way along the pipe from the first pair to the last at even speed, m."""
        return (self.frames - 1) * self.path.period * self.path.speed

    @property
    def built_way(self) -> float:
        """The way along the pipe for which there is a sea, m."""
        return max(self.way, self.stretch)
