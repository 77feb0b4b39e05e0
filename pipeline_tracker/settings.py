"""One model of all settings: default, range, unit and description.

ROS parameters, YAML files, ``--set`` and the README's table are made from it; ``settings_io`` loads
and describes it.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


def finite(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values, or refuse them where one is not finite."""
    if not all(math.isfinite(v) for v in values):
        raise ValueError("every number must be finite")
    return values


def with_length(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values, or refuse them where they are too short for a direction."""
    if math.hypot(*values) < 1e-6:
        raise ValueError("a direction must have a length")
    return values


def on_earth(values: tuple[float, ...]) -> tuple[float, ...]:
    """Return latitude, longitude and height, or refuse them where there is no such place."""
    if not (abs(values[0]) <= 90.0 and abs(values[1]) <= 180.0):
        raise ValueError("latitude must be within -90 to 90, longitude within -180 to 180")
    return values


Vector = Annotated[tuple[float, float, float], AfterValidator(finite)]
Direction = Annotated[Vector, AfterValidator(with_length)]
Place = Annotated[Vector, AfterValidator(on_earth)]


# The nodes, as far as a setting of theirs may change while they run.
_VECTORIZER = "stereo_vectorizer"
_RECOGNIZER = "local_recognizer"
_TRACKER = "pipe_tracker"
_PUBLISHER = "relative_state_publisher"


def _setting(
    default: Any, description: str, *, unit: str = "", live: tuple[str, ...] = (), **bounds: Any
) -> Any:
    """A setting; ``live`` names the nodes that take another value while they run.

    These are limits and times. What decides on memory, topics, cameras or the pipe stays as it is
    until a node is configured anew.
    """
    extra: dict[str, Any] = {"unit": unit, "live": list(live)}
    return Field(default, description=description, json_schema_extra=extra, **bounds)


class Section(BaseModel):
    """A group of settings; unknown keys are refused and values are not changed silently."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True, validate_default=True
    )


class PipeSettings(Section):
    """The pipe."""

    diameter: float = _setting(
        ..., "Outer diameter of the pipe, coating included; must be given", unit="m", gt=0, le=10
    )


class CameraSettings(Section):
    """The left optical frame's mounting in base_link, and whether images are to be rectified."""

    translation: Vector | None = _setting(
        None, "Position of the left optical frame in base_link; else from /tf_static", unit="m"
    )
    rotation_rpy: Vector | None = _setting(
        None,
        "Roll, pitch, yaw of the left optical frame in base_link; straight down, top of the "
        "picture forward: [3.1416, 0, -1.5708]; else from /tf_static",
        unit="rad",
    )
    rectify: bool = _setting(
        False, "The images are not rectified (image_raw): rectify them by CameraInfo's K, D, R, P"
    )


class FrameSettings(Section):
    """Names of coordinate frames."""

    base_link: str = _setting("base_link", "The vehicle's frame (REP 103)", min_length=1)
    odom: str = _setting("odom", "The frame of the VNM poses (REP 105)", min_length=1)
    left_optical: str = _setting("", "Left optical frame; empty: as the image's header says")


class TopicSettings(Section):
    """Topics of a bag, where their types and names leave a doubt (offline only)."""

    left_image: str = _setting("", "Left image; empty: found by type and name")
    right_image: str = _setting("", "Right image; empty: found by type and name")
    left_info: str = _setting("", "Left camera info; empty: found by type and name")
    right_info: str = _setting("", "Right camera info; empty: found by type and name")
    pose: str = _setting("", "VNM pose; empty: found by type and name")
    range: str = _setting("", "Echo sounder; empty: found by type and name")


class ImageSettings(Section):
    """How images become 8-bit grey."""

    mono16_white: int = _setting(
        65535,
        "Value of a mono16 pixel that becomes white, the same for every image; a camera of 12 bits "
        "in the low bits has 4095",
        ge=255,
        le=65535,
    )
    max_pixels: int = _setting(
        64_000_000, "Larger images are refused", unit="px", ge=10_000, le=1_000_000_000
    )
    max_age: float = _setting(
        2.0,
        "Live, an image that comes later than this after its stamp is not used; only where the "
        "cameras' clock is the nodes'",
        unit="s",
        live=(_VECTORIZER,),
        gt=0,
        le=3600,
    )


class SyncSettings(Section):
    """How left and right images are put together."""

    tolerance: float = _setting(
        0.002, "Left and right belong together within this time", unit="s", ge=0, le=1
    )
    max_wait: float = _setting(
        5.0, "An image waits this long for its partner (stamp time)", unit="s", gt=0, le=60
    )
    queue: int = _setting(8, "Images held at most for each camera", ge=1, le=100)


class PoseSettings(Section):
    """How VNM poses are used."""

    max_gap: float = _setting(
        3.0, "Poses are interpolated over gaps up to this", unit="s", gt=0, le=60
    )
    wait: float = _setting(
        0.2,
        "Live, an image waits this long for its pose",
        unit="s",
        live=(_TRACKER, _PUBLISHER),
        ge=0,
        le=10,
    )
    max_speed: float = _setting(
        5.0,
        "A faster move between two frames is a jump of the pose: reset",
        unit="m/s",
        live=(_TRACKER,),
        gt=0,
    )


class VectorizationSettings(Section):
    """Image to segments and matches (4.1.1)."""

    min_length: float = _setting(
        12.0,
        "Segments shorter than this are dropped, at a width of 1200 px (scales with it)",
        unit="px",
        gt=2,
        le=500,
    )
    split_tolerance: float = _setting(
        1.2, "A broken line is split where it deviates by more", unit="px", gt=0.1, le=20
    )
    match_spacing: int = _setting(
        14,
        "Grid of patches matched between the images, where the surface stands out (elsewhere three "
        "times that), at 1200 px width",
        unit="px",
        ge=6,
        le=200,
    )


class RecognitionSettings(Section):
    """A frame with no past (4.2)."""

    technique: Literal["auto", 1, 2, 3, 4] = _setting(
        "auto", "Technique of 4.2.4, 4 is the joint fit; auto: the best the picture allows"
    )
    min_support: float = _setting(
        0.2, "Least share of the expected evidence for a pipe", live=(_RECOGNIZER,), ge=0, le=1
    )
    only: bool = _setting(False, "Every frame by itself, no tracking (the paper's Table 2)")


class TrackingSettings(Section):
    """A frame with a past (4.1)."""

    refine: bool = _setting(
        True, "Continue from the best candidate to a fit; false: the paper's discrete result"
    )
    min_support: float = _setting(
        0.15,
        "Below this share of the expected evidence the frame is lost",
        live=(_TRACKER,),
        ge=0,
        le=1,
    )
    max_coast: float = _setting(
        2.0,
        "The pose alone carries a lost pipe over at most this way",
        unit="m",
        live=(_TRACKER,),
        ge=0,
        le=100,
    )
    max_coast_time: float = _setting(
        6.0,
        "The pose alone carries a lost pipe for at most this time",
        unit="s",
        live=(_TRACKER,),
        ge=0,
        le=600,
    )


class MotionSettings(Section):
    """The vehicle's motion S (4.3)."""

    window: float = _setting(
        1.0,
        "S is the way of this time before the image",
        unit="s",
        live=(_PUBLISHER,),
        gt=0,
        le=60,
    )
    min_speed: float = _setting(
        0.05,
        "A slower vehicle has no direction of motion: its own axis is used",
        unit="m/s",
        live=(_TRACKER, _PUBLISHER),
        ge=0,
    )
    min_overlap: float = _setting(
        0.3,
        "A warning where the next image shows less of the pipe in view again (5.3.1)",
        live=(_TRACKER,),
        ge=0,
        lt=1,
    )


class SegmentSettings(Section):
    """The published piece of the axis."""

    length: float = _setting(0.5, "Length of the published axis segment", unit="m", gt=0, le=10)


class OutputSettings(Section):
    """What is published when nothing comes in."""

    timeout: float = _setting(
        0.0,
        "Invalid state after this time without good input; 0: three image periods, at least 0.5 s",
        unit="s",
        live=(_PUBLISHER,),
        ge=0,
        le=3600,
    )


class ResultSettings(Section):
    """What a replay keeps for people to look at (offline only)."""

    image_width: int = _setting(
        640,
        "Width of the left images in the result bag, no wider than the camera's; 0: none",
        unit="px",
        ge=0,
        le=10_000,
    )


class ExportSettings(Section):
    """Where odom lies on the earth (`export` only)."""

    origin: Place | None = _setting(
        None,
        "Latitude, longitude (WGS 84) and height above the ellipsoid of odom's origin; GeoJSON "
        "needs it",
        unit="deg, deg, m",
    )
    yaw: float = _setting(
        0.0,
        "Angle from east to odom's x axis, positive to north; 0: x is east (REP 103)",
        unit="rad",
        ge=-6.3,
        le=6.3,
    )


class AltimeterSettings(Section):
    """The echo sounder (mono); its beam, where no transform of its frame is known."""

    translation: Vector = _setting((0.0, 0.0, 0.0), "Origin of the beam in base_link", unit="m")
    direction: Direction = _setting((0.0, 0.0, -1.0), "Direction of the beam in base_link")
    sigma: float = _setting(
        0.03,
        "Least standard deviation of a range; its message's own variance counts where it is more",
        unit="m",
        gt=0,
        le=1,
    )
    max_age: float = _setting(
        0.5, "An older echo is not used for a frame without a pose", unit="s", ge=0, le=10
    )


class AblationSettings(Section):
    """Parts of the method that can be left out, to see what each is worth; not for the sea."""

    surface: bool = _setting(True, "Use the surface points; false: contours alone")
    prior: bool = _setting(True, "Fits know of the prediction by the pose; false: its start alone")


class Settings(Section):
    """All settings."""

    mode: Literal["stereo", "mono"] = _setting("stereo", "Stereo pair, or left camera only (5.2)")
    pose_type: Literal["pose", "pose_with_covariance", "odometry"] = _setting(
        "pose", "Message type of vnm/pose"
    )
    image_transport: Literal["raw", "compressed"] = _setting(
        "raw", "Live image transport; replay takes what the bag has"
    )
    use_sim_time: bool = _setting(False, "Take the time from /clock (live)")
    autostart: bool = _setting(
        True, "Nodes configure and activate themselves; false: a lifecycle manager does (live)"
    )
    pipe: PipeSettings
    camera: CameraSettings = CameraSettings()
    frames: FrameSettings = FrameSettings()
    topics: TopicSettings = TopicSettings()
    image: ImageSettings = ImageSettings()
    sync: SyncSettings = SyncSettings()
    pose: PoseSettings = PoseSettings()
    vectorization: VectorizationSettings = VectorizationSettings()
    recognition: RecognitionSettings = RecognitionSettings()
    tracking: TrackingSettings = TrackingSettings()
    motion: MotionSettings = MotionSettings()
    segment: SegmentSettings = SegmentSettings()
    output: OutputSettings = OutputSettings()
    altimeter: AltimeterSettings = AltimeterSettings()
    result: ResultSettings = ResultSettings()
    export: ExportSettings = ExportSettings()
    ablation: AblationSettings = AblationSettings()

    @property
    def radius(self) -> float:
        """The pipe's radius, m."""
        return self.pipe.diameter / 2.0
