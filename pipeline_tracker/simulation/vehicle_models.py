"""The models of what a scenario's vehicle carries and does: camera, path, navigation, sensors.

Angles carry ``_deg`` in their name where they are degrees; ``camera.translation`` and
``camera.rotation_rpy`` mean what they mean in the settings (metres, radians).
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.settings import Section, Vector
from pipeline_tracker.simulation.scenario_values import Gains, value


class CameraModel(Section):
    """The stereo camera, rectified."""

    width: int = value(800, "Image width", unit="px", ge=64, le=8000)
    height: int = value(536, "Image height", unit="px", ge=64, le=8000)
    field_of_view_deg: float = value(65.5, "Horizontal field of view", unit="deg", gt=5, lt=150)
    baseline: float = value(0.2, "Distance between the cameras", unit="m", gt=0, le=5)
    translation: Vector = value((0.3, 0.1, -0.1), "Left optical frame in base_link", unit="m")
    rotation_rpy: Vector = value(
        (-2.617993877991494, 0.0, -1.5707963267948966),
        "Roll, pitch, yaw of the left optical frame in base_link",
        unit="rad",
    )
    encoding: Literal["bgr8", "mono8"] = value("bgr8", "Colour or grey")
    jpeg_quality: Annotated[int, Field(ge=30, le=100)] | None = value(
        90, "Quality of compressed images; null: raw images"
    )
    exposure: float = value(
        0.22, "Level of a grey surface (30 %) on the bed ahead, of full scale", gt=0, le=1
    )
    gamma: float = value(1.8, "Level = light to the power 1 / gamma", ge=1, le=3)
    white_balance: Gains = value((1.7, 1.0, 1.1), "Gains of red, green, blue")
    blur: float = value(0.6, "Blur of the lens (one sigma)", unit="px", ge=0, le=10)
    vignetting: float = value(0.6, "Share of the natural (cos^4) fall-off", ge=0, le=1)
    full_well: float = value(9000.0, "Electrons at full scale: shot noise", ge=50, le=1e7)
    read_noise: float = value(12.0, "Noise of the dark image", unit="electrons", ge=0, le=1e5)

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

    speed: float = value(0.5, "Speed along the pipe", unit="m/s", gt=0.01, le=5)
    period: float = value(1.0, "Time between two pairs", unit="s", ge=0.02, le=60)
    distance: float = value(
        2.0, "Height of the left camera above the pipe's top", unit="m", gt=0, le=30
    )
    lateral_start: float = value(0.45, "To port of the pipe at first", unit="m", ge=-20, le=20)
    lateral_end: float = value(0.0, "To port of the pipe in the end", unit="m", ge=-20, le=20)
    lateral_settle: float = value(3.0, "Way to go from one to the other", unit="m", gt=0.1)
    lateral_sway: float = value(0.10, "Swaying to port and starboard", unit="m", ge=0, le=10)
    distance_sway: float = value(0.15, "Rising and sinking", unit="m", ge=0, le=10)
    heading_sway_deg: float = value(5.0, "Swaying of the heading", unit="deg", ge=0, le=60)
    pitch_sway_deg: float = value(2.5, "Swaying of the pitch", unit="deg", ge=0, le=45)
    roll_sway_deg: float = value(2.0, "Swaying of the roll", unit="deg", ge=0, le=45)
    sway_period: float = value(13.0, "Typical period of all swaying", unit="s", ge=1, le=600)


class VnmModel(Section):
    """The visual navigation: exact from the first frame on but for what it adds up."""

    rate: float = value(
        10.0, "Poses (and altimeter, attitude) in a second", unit="Hz", gt=0, le=200
    )
    drift: float = value(0.004, "Random walk of the position after one metre", unit="m", ge=0, le=1)
    scale: float = value(0.004, "Error of scale, drawn for the run (one sigma)", ge=0, le=0.2)
    heading_drift_deg: float = value(
        0.15, "Random walk of the heading after one metre", unit="deg", ge=0, le=10
    )
    level_error_deg: float = value(
        0.15, "Wandering of roll and pitch (one sigma)", unit="deg", ge=0, le=10
    )


class SensorModel(Section):
    """Altimeter and attitude sensor."""

    altimeter_noise: float = value(0.02, "Noise of the altimeter", unit="m", ge=0, le=1)
    attitude_noise_deg: float = value(
        0.15, "Noise of roll and pitch of the attitude sensor", unit="deg", ge=0, le=10
    )
