"""What goes from step to step: the core's own types, one for each ROS message.

float32 in a message is float32 here too, so that a step sees the same numbers whether its input
came over DDS or by a call.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import StereoRig

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Image = NDArray[np.uint8]


class Mode(IntEnum):
    """Which of the paper's two modes gave a segment."""

    RECOGNITION = 0
    TRACKING = 1


class State(IntEnum):
    """State of the tracker."""

    SEARCHING = 0
    TRACKING = 1
    COASTING = 2


class Side(IntEnum):
    """Where the vehicle is relative to the pipe, seen along travel."""

    ALONG = 0
    LEFT_OF_PIPE = 1
    RIGHT_OF_PIPE = 2
    NOT_IN_VIEW = 3


class Contours(IntFlag):
    """Visible contours; the second word is the side seen along travel."""

    NONE = 0
    LEFT_IMAGE_LEFT = 1
    LEFT_IMAGE_RIGHT = 2
    RIGHT_IMAGE_LEFT = 4
    RIGHT_IMAGE_RIGHT = 8


@dataclass(frozen=True)
class VectorizedStereo:
    """A vectorized stereo pair: all that later steps need of the images (4.1.1).

    Attributes:
        stamp_ns: stamp of the left image, ns.
        rig: the rectified cameras.
        left_segments, right_segments: (N, 4) float32, x1 y1 x2 y2, px.
        matches: (M, 4) float32, x_left y_left x_right y_right, px.
        left_thumbnail, right_thumbnail: uint8, each side of the image / 8 rounded down.
        processing_time: s.
    """

    stamp_ns: int
    rig: StereoRig
    left_segments: Float32Array
    right_segments: Float32Array
    matches: Float32Array
    left_thumbnail: Image
    right_thumbnail: Image
    processing_time: float = 0.0


@dataclass(frozen=True)
class PipeSegment:
    """A piece of the pipe's axis in base_link, or none (support 0).

    Attributes:
        stamp_ns: stamp of the left image, ns.
        mode: recognition or tracking.
        technique: 0 tracking, 1 to 3 the paper's, 4 joint fit.
        start, end: ends of the axis piece, (3,), m; start behind, end ahead along travel.
        radius: m.
        covariance: 4 x 4, of the axis at the segment's middle: left m, up m, heading rad,
            pitch rad.
        support: share of evidence, 0 (none found) to 1, rounded to float32.
        visible_contours: which contours were seen.
        contours: (K, 4) float32, x1 y1 x2 y2 for each bit set, in bit order, px.
    """

    stamp_ns: int
    mode: Mode
    technique: int
    start: Array
    end: Array
    radius: float
    covariance: Array
    support: float
    visible_contours: Contours = Contours.NONE
    contours: Float32Array = field(default_factory=lambda: np.zeros((0, 4), np.float32))

    @property
    def found(self) -> bool:
        """Whether there is a pipe in it at all."""
        return self.support > 0.0

    @classmethod
    def none(cls, stamp_ns: int, radius: float, mode: Mode = Mode.RECOGNITION) -> PipeSegment:
        """Return the answer "no pipe found"."""
        return cls(stamp_ns, mode, 0, np.zeros(3), np.zeros(3), radius, np.zeros((4, 4)), 0.0)


@dataclass(frozen=True)
class TrackingStatus:
    """What became of one frame.

    Attributes:
        stamp_ns: stamp of the left image, ns.
        state: searching, tracking or coasting.
        reason: why, in words; empty where all is well.
        support: of the segment, 0 to 1.
        seconds_since_seen: s since the pipe was last seen; -1 never.
        reset_counter: how often the tracker has forgotten its past.
        processing_time: s.
    """

    stamp_ns: int
    state: State
    reason: str
    support: float
    seconds_since_seen: float
    reset_counter: int
    processing_time: float = 0.0


@dataclass(frozen=True)
class RelativeState:
    """How the vehicle stands to the pipe and moves relative to it (4.3), in base_link.

    A number that is not known is 0 with its variance -1; see ``design`` of the message.
    """

    stamp_ns: int
    valid: bool
    quality: float
    reset_counter: int
    heading_misalignment: float = 0.0
    pitch_misalignment: float = 0.0
    min_distance: float = 0.0
    min_distance_base: float = 0.0
    approach_speed: float = 0.0
    lateral_offset: float = 0.0
    vertical_offset: float = 0.0
    side: Side = Side.NOT_IN_VIEW
    motion_observed: bool = False
    upper_point: Array = field(default_factory=lambda: np.zeros(3))
    upper_point_vertical: Array = field(default_factory=lambda: np.zeros(3))
    chainage: float = 0.0
    heading_variance: float = -1.0
    pitch_variance: float = -1.0
    distance_variance: float = -1.0
    speed_variance: float = -1.0
