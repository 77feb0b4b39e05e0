"""The model of a scenario: everything that a simulated sea is made from.

Strict as the settings are: unknown keys, values out of range and values of another type are
refused. Angles carry ``_deg`` in their name where they are degrees; ``camera.translation`` and
``camera.rotation_rpy`` mean what they mean in the settings (metres, radians).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.settings import Section, Vector

Array = NDArray[np.float64]

Share = Annotated[float, Field(ge=0, le=1)]
Colour = tuple[Share, Share, Share]
Coefficient = Annotated[float, Field(ge=0, le=20)]
Coefficients = tuple[Coefficient, Coefficient, Coefficient]
Gain = Annotated[float, Field(gt=0, le=10)]
Gains = tuple[Gain, Gain, Gain]


def _value(default: Any, description: str, *, unit: str = "", **bounds: Any) -> Any:
    extra: dict[str, Any] = {"unit": unit}
    return Field(default, description=description, json_schema_extra=extra, **bounds)


class PipeModel(Section):
    """The pipe."""

    diameter: float = _value(0.6, "Outer diameter", unit="m", gt=0.02, le=10)
    bend_radius: float = _value(45.0, "Least radius of the bends sideways", unit="m", ge=3, le=1e6)
    bend_length: float = _value(16.0, "Length of a bend to port and one back", unit="m", ge=2)
    sag_radius: float = _value(70.0, "Least radius of the bends upward", unit="m", ge=3, le=1e6)
    sag_length: float = _value(9.0, "Length of a rise and a fall", unit="m", ge=2)
    joint_spacing: float = _value(6.0, "Way between field joints", unit="m", gt=0.5)
    colour: Colour = _value((0.22, 0.22, 0.20), "Share of light returned: red, green, blue")
    texture: float = _value(0.5, "Contrast of the surface", ge=0, le=2)
    growth: float = _value(0.3, "Share of the surface under growth", ge=0, le=1)
    sediment: float = _value(0.3, "Share of the upper side dusted with sediment", ge=0, le=1)


class DriftModel(Section):
    """A heap of silt on the bed, which may cover a part of the pipe."""

    at: float = _value(..., "Chainage of its middle", unit="m")
    offset: float = _value(0.0, "Its middle to port of the axis", unit="m", ge=-20, le=20)
    length: float = _value(1.0, "Extent along the pipe (one sigma)", unit="m", gt=0.05, le=100)
    width: float = _value(0.5, "Extent across the pipe (one sigma)", unit="m", gt=0.05, le=100)
    height: float = _value(0.3, "Height above the bed around it", unit="m", ge=0, le=5)


class BedModel(Section):
    """The bed, a height field with stones."""

    burial: float = _value(0.15, "Share of the diameter below the bed", ge=-1, le=1.5)
    burial_variation: float = _value(0.08, "How much that varies along the pipe", ge=0, le=1)
    relief: float = _value(0.12, "Height of the large undulations", unit="m", ge=0, le=3)
    relief_length: float = _value(3.0, "Length of the large undulations", unit="m", ge=0.3, le=100)
    roughness: float = _value(0.02, "Height of the small unevenness", unit="m", ge=0, le=0.3)
    ripple_height: float = _value(0.012, "Height of sand ripples", unit="m", ge=0, le=0.2)
    ripple_length: float = _value(0.22, "Length of sand ripples", unit="m", ge=0.08, le=5)
    stones: float = _value(0.7, "Stones on a square metre", unit="1/m²", ge=0, le=20)
    stone_size: float = _value(0.07, "Median size of a stone", unit="m", gt=0.01, le=2)
    resolution: float = _value(0.025, "Spacing of the height field", unit="m", ge=0.005, le=0.5)
    colour: Colour = _value((0.33, 0.30, 0.24), "Share of light returned: red, green, blue")
    texture: float = _value(0.6, "Contrast of the surface", ge=0, le=2)
    drifts: tuple[DriftModel, ...] = _value((), "Heaps of silt", max_length=100)


class LampModel(Section):
    """A lamp fixed to the vehicle."""

    position: Vector = _value((0.4, -0.3, -0.1), "Position in base_link", unit="m")
    direction: Vector = _value((0.5, 0.1, -1.0), "Direction of the beam in base_link")
    half_angle_deg: float = _value(
        45.0, "Angle off the beam's axis where half its strength is left", unit="deg", gt=1, le=120
    )
    power: float = _value(1.0, "Strength relative to the other lamps", gt=0, le=1000)
    radius: float = _value(0.04, "Radius of the lamp; larger gives softer shadows", unit="m", ge=0)
    colour: Colour = _value((1.0, 1.0, 1.0), "Red, green, blue")

    @model_validator(mode="after")
    def _has_direction(self) -> LampModel:
        if float(np.linalg.norm(self.direction)) < 1e-6:
            raise ValueError("direction is a zero vector; give it a length")
        return self


class WaterModel(Section):
    """What the water does to light."""

    attenuation: Coefficients = _value(
        (0.38, 0.14, 0.17), "Light lost on each metre: red, green, blue", unit="1/m"
    )
    backscatter: Coefficients = _value(
        (0.010, 0.014, 0.013), "Light scattered back on each metre: red, green, blue", unit="1/m"
    )
    halo: float = _value(0.25, "Share of light scattered forward into a halo", ge=0, le=0.95)
    halo_deg: float = _value(0.5, "Width of that halo (one sigma)", unit="deg", gt=0, le=10)
    ambient: float = _value(
        0.04, "Light from above, relative to the lamps' on the bed ahead", ge=0, le=100
    )


class CameraModel(Section):
    """The stereo camera, rectified."""

    width: int = _value(800, "Image width", unit="px", ge=64, le=8000)
    height: int = _value(536, "Image height", unit="px", ge=64, le=8000)
    field_of_view_deg: float = _value(65.5, "Horizontal field of view", unit="deg", gt=5, lt=150)
    baseline: float = _value(0.2, "Distance between the cameras", unit="m", gt=0, le=5)
    translation: Vector = _value((0.3, 0.1, -0.1), "Left optical frame in base_link", unit="m")
    rotation_rpy: Vector = _value(
        (-2.617993877991494, 0.0, -1.5707963267948966),
        "Roll, pitch, yaw of the left optical frame in base_link",
        unit="rad",
    )
    encoding: Literal["bgr8", "mono8"] = _value("bgr8", "Colour or grey")
    jpeg_quality: Annotated[int, Field(ge=30, le=100)] | None = _value(
        90, "Quality of compressed images; null: raw images"
    )
    exposure: float = _value(
        0.22, "Level of a grey surface (30 %) on the bed ahead, of full scale", gt=0, le=1
    )
    gamma: float = _value(1.8, "Level = light to the power 1 / gamma", ge=1, le=3)
    white_balance: Gains = _value((1.7, 1.0, 1.1), "Gains of red, green, blue")
    blur: float = _value(0.6, "Blur of the lens (one sigma)", unit="px", ge=0, le=10)
    vignetting: float = _value(0.6, "Share of the natural (cos^4) fall-off", ge=0, le=1)
    full_well: float = _value(9000.0, "Electrons at full scale: shot noise", ge=50, le=1e7)
    read_noise: float = _value(12.0, "Noise of the dark image", unit="electrons", ge=0, le=1e5)

    def rig(self) -> StereoRig:
        """Return the two rectified cameras."""
        focal = self.width / 2.0 / float(np.tan(np.deg2rad(self.field_of_view_deg) / 2.0))
        cx, cy = (self.width - 1) / 2.0, (self.height - 1) / 2.0
        left = Camera(focal, focal, cx, cy, self.width, self.height)
        right = Camera(focal, focal, cx, cy, self.width, self.height, offset=self.baseline)
        return StereoRig(left, right)

    def mounting(self) -> Pose:
        """Return base_link <- left optical frame."""
        return Pose.from_rpy(self.translation, self.rotation_rpy)


class PathModel(Section):
    """How the vehicle goes along the pipe."""

    speed: float = _value(0.5, "Speed along the pipe", unit="m/s", gt=0.01, le=5)
    period: float = _value(1.0, "Time between two pairs", unit="s", ge=0.02, le=60)
    distance: float = _value(
        2.0, "Height of the left camera above the pipe's top", unit="m", gt=0, le=30
    )
    lateral_start: float = _value(0.45, "To port of the pipe at first", unit="m", ge=-20, le=20)
    lateral_end: float = _value(0.0, "To port of the pipe in the end", unit="m", ge=-20, le=20)
    lateral_settle: float = _value(3.0, "Way to go from one to the other", unit="m", gt=0.1)
    lateral_sway: float = _value(0.10, "Swaying to port and starboard", unit="m", ge=0, le=10)
    distance_sway: float = _value(0.15, "Rising and sinking", unit="m", ge=0, le=10)
    heading_sway_deg: float = _value(5.0, "Swaying of the heading", unit="deg", ge=0, le=60)
    pitch_sway_deg: float = _value(2.5, "Swaying of the pitch", unit="deg", ge=0, le=45)
    roll_sway_deg: float = _value(2.0, "Swaying of the roll", unit="deg", ge=0, le=45)
    sway_period: float = _value(13.0, "Typical period of all swaying", unit="s", ge=1, le=600)


class VnmModel(Section):
    """The visual navigation: exact from the first frame on but for what it adds up."""

    rate: float = _value(
        10.0, "Poses (and altimeter, attitude) in a second", unit="Hz", gt=0, le=200
    )
    drift: float = _value(
        0.004, "Random walk of the position after one metre", unit="m", ge=0, le=1
    )
    scale: float = _value(0.004, "Error of scale, drawn for the run (one sigma)", ge=0, le=0.2)
    heading_drift_deg: float = _value(
        0.15, "Random walk of the heading after one metre", unit="deg", ge=0, le=10
    )
    level_error_deg: float = _value(
        0.15, "Wandering of roll and pitch (one sigma)", unit="deg", ge=0, le=10
    )


class SensorModel(Section):
    """Altimeter and attitude sensor."""

    altimeter_noise: float = _value(0.02, "Noise of the altimeter", unit="m", ge=0, le=1)
    attitude_noise_deg: float = _value(
        0.15, "Noise of roll and pitch of the attitude sensor", unit="deg", ge=0, le=10
    )


class Scenario(Section):
    """A whole scenario."""

    description: str = _value("", "What is in it, in one line")
    frames: int = _value(20, "Number of stereo pairs", ge=1, le=100_000)
    seed: int = _value(1, "Another seed: another bed, texture, path and noise", ge=0, lt=2**63)
    pipe: PipeModel = PipeModel()
    bed: BedModel = BedModel()
    lamps: tuple[LampModel, ...] = _value((LampModel(),), "Lamps", min_length=1, max_length=16)
    water: WaterModel = WaterModel()
    camera: CameraModel = CameraModel()
    path: PathModel = PathModel()
    vnm: VnmModel = VnmModel()
    sensors: SensorModel = SensorModel()

    @property
    def radius(self) -> float:
        """The pipe's radius, m."""
        return self.pipe.diameter / 2.0

    @property
    def way(self) -> float:
        """The way along the pipe from the first pair to the last, m."""
        return (self.frames - 1) * self.path.period * self.path.speed
