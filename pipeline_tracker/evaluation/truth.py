"""The truth of a bag: the vehicle's pose, the pipe's axis, the cameras, what hides the contours."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import EvaluationError, MessageError, SettingsError
from pipeline_tracker.evaluation.axis import TrueAxis
from pipeline_tracker.evaluation.contours import (
    TrueContours,
    contours_from_message,
    is_detectable,
)
from pipeline_tracker.evaluation.recording import Recording, known_mounting, read_recording
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.messages import (
    pose_from_message,
    stamp_ns,
)
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import parse_yaml

Array = NDArray[np.float64]

POSE = "/ground_truth/pose"
CENTERLINE = "/ground_truth/centerline"
CONTOURS = ("/ground_truth/contours/left", "/ground_truth/contours/right")
SCENARIO = "/ground_truth/scenario"
# A true pose is taken between two others that are so near to each other, s.
_POSE_GAP = 0.2
_FOREVER = 1e9


@dataclass
class Truth:
    """The truth of a bag.

    Attributes:
        path: the bag.
        poses: world <- base_link, for the place of a frame.
        track: the same, interpolated as far as a replay interpolates its own, for the motion.
        axis: the true axis, put together from all stretches.
        stretches: the stretch published with a frame, (M, 3), m, by stamp.
        rig: the cameras, or None where they are not known.
        mounting: base_link <- left optical frame, or None where it is not known.
        detectable: whether the left image shows enough of a contour, by stamp; None where the bag
            does not tell what is hidden.
        contours: the contours in the left and in the right image, by stamp; empty where the bag
            does not tell them.
        recording: what else the bag has.
        scenario: the scenario of a simulated bag.
    """

    path: Path
    poses: PoseBuffer
    track: PoseBuffer
    axis: TrueAxis
    stretches: dict[int, Array]
    rig: StereoRig | None = None
    mounting: Pose | None = None
    detectable: dict[int, bool] | None = None
    contours: tuple[dict[int, TrueContours], dict[int, TrueContours]] = field(
        default_factory=lambda: ({}, {})
    )
    recording: Recording = field(default_factory=Recording)
    scenario: dict[str, Any] | None = None

    @property
    def radius(self) -> float | None:
        """The pipe's radius as the scenario has it, m; None where there is none."""
        pipe = (self.scenario or {}).get("pipe")
        diameter = pipe.get("diameter") if isinstance(pipe, dict) else None
        return diameter / 2.0 if isinstance(diameter, int | float) and diameter > 0.0 else None

    def near(self, stamp: int) -> list[Array]:
        """Return the polylines that may be in view in a frame, (M, 3) each, m.

        The stretch published with the frame, else all of them.
        """
        own = self.stretches.get(stamp)
        return list(self.stretches.values()) if own is None else [own]


def read_truth(
    path: Path,
    settings: Settings,
    thumbnails: Collection[int] = (),
    rig: StereoRig | None = None,
) -> Truth:
    """Read the truth of a bag.

    Args:
        path: the bag.
        settings: the replay's settings; names of topics and frames, and the mounting where the
            bag's static transforms do not give it.
        thumbnails: stamps of frames of which to make the left thumbnail, ns.
        rig: the cameras where the bag has no calibration.

    Raises:
        EvaluationError: the bag has no truth.
        BagError: the bag cannot be read.
    """
    with BagReader(path) as bag:
        missing = [t for t in (POSE, CENTERLINE) if t not in bag.topics]
        if missing:
            raise EvaluationError(
                f"{path}: no truth in this bag, {missing[0]} is missing; "
                "expected a bag made by `pipeline-tracker simulate`, or one with that topic"
            )
        poses, track = PoseBuffer(_POSE_GAP, _FOREVER), PoseBuffer(settings.pose.max_gap, _FOREVER)
        stretches: dict[int, Array] = {}
        frames: dict[str, str] = {}
        for record in bag.records([POSE, CENTERLINE]):
            message = record.unpack()
            frames.setdefault(record.topic, message.header.frame_id)
            if record.topic == POSE:
                stamp, pose = _pose(path, message)
                if poses.add(stamp, pose):
                    track.add(stamp, pose)
            else:
                stretches[stamp_ns(message.header)] = _stretch(path, message)
        if len(set(frames.values())) > 1:
            raise EvaluationError(
                f"{path}: {POSE} is in the frame {frames[POSE]!r} and {CENTERLINE} in "
                f"{frames[CENTERLINE]!r}, expected one frame for both"
            )
        truth = Truth(path, poses, track, TrueAxis(stretches.values()), stretches)
        _add_contours(bag, truth)
        truth.recording = read_recording(bag, settings, thumbnails)
        truth.rig = truth.recording.rig or rig
        truth.mounting = known_mounting(truth.recording, settings)
        truth.scenario = scenario_of(bag)
    return truth


def _add_contours(bag: BagReader, truth: Truth) -> None:
    for record in bag.records([name for name in CONTOURS if name in bag.topics]):
        message = record.unpack()
        pixels, flags = contours_from_message(message, record.topic)
        if len(flags) != 2:
            raise EvaluationError(
                f"{bag.path}: {record.topic} has {len(flags)} rows of contours, expected 2: left "
                "and right of the pipe"
            )
        image = CONTOURS.index(record.topic)
        truth.contours[image][stamp_ns(message.header)] = TrueContours(pixels, flags)
    if truth.contours[0]:
        truth.detectable = {
            stamp: is_detectable(told.pixels, told.flags)
            for stamp, told in truth.contours[0].items()
        }


def scenario_of(bag: BagReader) -> dict[str, Any] | None:
    """Return the scenario that a bag was simulated from; None where it does not tell.

    Raises:
        EvaluationError: what it says is no YAML.
        BagError: the bag cannot be read.
    """
    if SCENARIO not in bag.topics:
        return None
    try:
        scenario = parse_yaml(str(bag.first(SCENARIO).data).encode(), "")
    except SettingsError as error:
        raise EvaluationError(f"{bag.path}: {SCENARIO} cannot be read: {error}") from None
    return scenario if isinstance(scenario, dict) else None


def _pose(path: Path, message: Any) -> tuple[int, Pose]:
    try:
        return pose_from_message(message)
    except MessageError as error:
        raise EvaluationError(f"{path}: {POSE} has a pose that is none: {error}") from None


def _stretch(path: Path, message: Any) -> Array:
    points = [pose.pose.position for pose in message.poses]
    stretch = np.array([[p.x, p.y, p.z] for p in points], dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(stretch).all():
        raise EvaluationError(f"{path}: {CENTERLINE} has a point that is not finite")
    return stretch
