"""The models of what a scenario's vehicle carries and does: camera, path, navigation, sensors.

Angles carry ``_deg`` in their name where they are degrees; ``camera.translation`` and
``camera.rotation_rpy`` mean what they mean in the settings (metres, radians).
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.settings import Section, Vector, finite
from pipeline_tracker.simulation.scenario_values import Gains, value

Pixels = Annotated[tuple[float, float], AfterValidator(finite)]


class DistortionModel(Section):
    """How the cameras differ from rectified ones, as a stereo calibration finds it."""

    model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = value(
        "plumb_bob", "Model of the lens, as CameraInfo names it"
    )
    coefficients: tuple[float, ...] = value(
        (-0.22, 0.06, 0.0008, -0.0006, 0.0),
        "D: k1 k2 p1 p2 k3 (plumb_bob), k1 k2 p1 p2 k3 k4 k5 k6 (rational_polynomial), "
        "k1 k2 k3 k4 (equidistant)",
    )
    focal_share: float = value(
        0.98, "Focal length of the cameras themselves in that of the rectified", ge=0.2, le=5
    )
    shifts: tuple[Pixels, Pixels] = value(
        ((4.0, -3.0), (-5.0, 2.0)),
        "Principal points of left and right camera off those of the rectified",
        unit="px",
    )
    turns_deg: tuple[Vector, Vector] = value(
        ((0.3, -0.2, 0.15), (-0.25, 0.3, -0.2)),
        "Roll, pitch, yaw of left and right camera in the rectified optical frames: R",
        unit="deg",
    )

    @model_validator(mode="after")
    def _fits_the_model(self) -> DistortionModel:
        expected = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}[self.model]
        if len(self.coefficients) != expected:
            raise ValueError(
                f"{self.model} has {expected} coefficients, got {len(self.coefficients)}"
            )
        return self


class CameraModel(Section):
    """The stereo camera.

    Field of view, mounting and baseline are those of the rectified cameras. With ``distortion``
    the images come as the cameras see them, unrectified.
    """

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
    exposure_variation: float = value(
        0.0, "Flicker of the exposure from pair to pair (one sigma of its logarithm)", ge=0, le=1
    )
    mismatch: float = value(0.0, "How much brighter the right camera is, as a share", ge=-0.9, le=5)
    gamma: float = value(1.8, "Level = light to the power 1 / gamma", ge=1, le=3)
    white_balance: Gains = value((1.7, 1.0, 1.1), "Gains of red, green, blue")
    blur: float = value(0.6, "Blur of the lens (one sigma)", unit="px", ge=0, le=10)
    vignetting: float = value(0.6, "Share of the natural (cos^4) fall-off", ge=0, le=1)
    full_well: float = value(9000.0, "Electrons at full scale: shot noise", ge=50, le=1e7)
    read_noise: float = value(12.0, "Noise of the dark image", unit="electrons", ge=0, le=1e5)

    distortion: DistortionModel | None = value(None, "Unrectified images; null: rectified")
    mono: bool = value(False, "One camera, the left; no right images")

    def rig(self) -> StereoRig:
        """Return the rectified cameras; the left alone in mono."""
        focal = self.width / 2.0 / float(np.tan(np.deg2rad(self.field_of_view_deg) / 2.0))
        cx, cy = (self.width - 1) / 2.0, (self.height - 1) / 2.0
        left = Camera(focal, focal, cx, cy, self.width, self.height)
        right = Camera(focal, focal, cx, cy, self.width, self.height, offset=self.baseline)
        return StereoRig(left, None if self.mono else right)

    def mounting(self) -> Pose:
        """Return base_link <- left optical frame."""
        return Pose.from_rpy(self.translation, self.rotation_rpy)


class ManoeuvreModel(Section):
    """The vehicle leaves its course for a while and comes back to it."""

    at: float = value(..., "Chainage of its middle", unit="m", ge=-1e4, le=1e6)
    length: float = value(2.0, "Way on which it is held", unit="m", ge=0, le=1e4)
    settle: float = value(2.0, "Way in, and way out again", unit="m", ge=0.2, le=1e3)
    lateral: float = value(0.0, "To port", unit="m", ge=-20, le=20)
    distance: float = value(0.0, "Further up", unit="m", ge=-20, le=20)
    heading_deg: float = value(0.0, "Turn to port", unit="deg", ge=-180, le=180)
    pitch_deg: float = value(0.0, "Nose down", unit="deg", ge=-60, le=60)
    roll_deg: float = value(0.0, "Starboard side down", unit="deg", ge=-60, le=60)


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
    speed_variation: float = value(0.0, "How much the speed varies, share of it", ge=0, le=0.9)
    manoeuvres: tuple[ManoeuvreModel, ...] = value(
        (), "Leavings of the course; they add up", max_length=100
    )

    @property
    def widest(self) -> float:
        """A bound of the way from the axis to either side, m."""
        aside = sum(abs(m.lateral) for m in self.manoeuvres)
        return max(abs(self.lateral_start), abs(self.lateral_end)) + self.lateral_sway + aside

    @property
    def highest(self) -> float:
        """A bound of the left camera's height above the pipe's top, m."""
        more = sum(max(m.distance, 0.0) for m in self.manoeuvres)
        return self.distance + self.distance_sway + more

    @property
    def steepest_deg(self) -> float:
        """A bound of pitch and roll together, degrees."""
        more = sum(abs(m.pitch_deg) + abs(m.roll_deg) for m in self.manoeuvres)
        return self.pitch_sway_deg + self.roll_sway_deg + more

    @property
    def surge(self) -> float:
        """A bound of how far a varying speed brings it off its even progress, m."""
        # Three sines of at most 1.9 times the period, whose slopes add up to the variation.
        return 0.62 * self.speed_variation * self.speed * self.sway_period


class DropoutModel(Section):
    """A time without messages."""

    at: float = value(..., "Its beginning after the first pair", unit="s", ge=0, le=1e7)
    duration: float = value(..., "How long it lasts", unit="s", gt=0, le=1e6)


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
    noise: float = value(
        0.0, "White noise of each coordinate of each pose (one sigma)", unit="m", ge=0, le=1
    )
    rotation_noise_deg: float = value(
        0.0, "White noise of each pose's roll, pitch, yaw (one sigma)", unit="deg", ge=0, le=10
    )
    dropouts: tuple[DropoutModel, ...] = value((), "Times without poses", max_length=100)
    dropout_rate: float = value(
        0.0, "Further dropouts at random, in a minute", unit="1/min", ge=0, le=60
    )
    dropout_duration: float = value(
        2.0, "Their mean duration (exponential)", unit="s", gt=0, le=600
    )


class SensorModel(Section):
    """Altimeter (echo sounder) and attitude sensor."""

    altimeter_noise: float = value(0.02, "Noise of the altimeter", unit="m", ge=0, le=1)
    altimeter_translation: Vector = value((0.0, 0.0, 0.0), "Its place in base_link", unit="m")
    altimeter_direction: Vector = value((0.0, 0.0, -1.0), "Direction of its beam in base_link")
    altimeter_beam_deg: float = value(
        3.0, "Width of its beam, whose first echo counts", unit="deg", ge=0, le=60
    )
    altimeter_reach: float = value(
        50.0, "No echo from further away: the range is +inf", unit="m", gt=0.5, le=1000
    )
    altimeter_loss: float = value(0.0, "Share of its pings without echo", ge=0, le=1)
    altimeter_dropouts: tuple[DropoutModel, ...] = value(
        (), "Times without its messages", max_length=100
    )
    attitude_noise_deg: float = value(
        0.15, "Noise of roll and pitch of the attitude sensor", unit="deg", ge=0, le=10
    )

    @model_validator(mode="after")
    def _has_direction(self) -> SensorModel:
        if float(np.linalg.norm(self.altimeter_direction)) < 1e-6:
            raise ValueError("altimeter_direction is a zero vector; give it a length")
        return self

    def altimeter(self) -> Pose:
        """Return base_link <- altimeter, whose beam is along its own x (as ROS's Range has it)."""
        x = np.array(self.altimeter_direction) / np.linalg.norm(self.altimeter_direction)
        # Any turn about the beam will do: the axis most square to it is the helper.
        y = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
        y /= np.linalg.norm(y)
        return Pose(np.stack((x, y, np.cross(x, y)), axis=1), np.array(self.altimeter_translation))
