"""The truth of a bag: the vehicle's pose, the pipe's axis, the cameras, what hides the contours."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.topics import ReplayTopics, find_topics
from pipeline_tracker.errors import BagError, CalibrationError, EvaluationError
from pipeline_tracker.evaluation.axis import TrueAxis
from pipeline_tracker.evaluation.contours import contours_from_message, is_detectable
from pipeline_tracker.geometry.camera import StereoRig, stereo_rig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.images import ImageError, decode_image
from pipeline_tracker.messages import (
    camera_from_info,
    pose_from_message,
    stamp_ns,
    transform_from_message,
)
from pipeline_tracker.mounting import StaticTransforms, find_mounting, mounting_from_settings
from pipeline_tracker.settings import Settings
from pipeline_tracker.vectorization.vectorizer import thumbnail

Array = NDArray[np.float64]

POSE = "/ground_truth/pose"
CENTERLINE = "/ground_truth/centerline"
CONTOURS = "/ground_truth/contours/left"
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
        rig: the cameras, or None where the bag has no calibration.
        mounting: base_link <- left optical frame, or None where it is not known.
        detectable: whether the left image shows enough of a contour, by stamp; None where the bag
            does not tell what is hidden.
        thumbnails: left thumbnail by stamp, of the frames asked for that have an image.
    """

    path: Path
    poses: PoseBuffer
    track: PoseBuffer
    axis: TrueAxis
    stretches: dict[int, Array]
    rig: StereoRig | None = None
    mounting: Pose | None = None
    detectable: dict[int, bool] | None = None
    thumbnails: dict[int, NDArray[np.uint8]] = field(default_factory=dict)

    def near(self, stamp: int) -> list[Array]:
        """Return the polylines that may be in view in a frame, (M, 3) each, m.

        The stretch published with the frame, else all of them.
        """
        own = self.stretches.get(stamp)
        return list(self.stretches.values()) if own is None else [own]


def read_truth(path: Path, settings: Settings, thumbnails: Collection[int] = ()) -> Truth:
    """Read the truth of a bag.

    Args:
        path: the bag.
        settings: the replay's settings; names of topics and frames, and the mounting where the
            bag's static transforms do not give it.
        thumbnails: stamps of frames of which to make the left thumbnail, ns.

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
        if CONTOURS in bag.topics:
            truth.detectable = {
                stamp_ns(message.header): is_detectable(*contours_from_message(message, CONTOURS))
                for message in (record.unpack() for record in bag.records([CONTOURS]))
            }
        _add_cameras(bag, settings, truth, thumbnails)
    return truth


def _pose(path: Path, message: Any) -> tuple[int, Pose]:
    try:
        return pose_from_message(message)
    except ValueError as error:
        raise EvaluationError(f"{path}: {POSE} has a pose that is none: {error}") from None


def _stretch(path: Path, message: Any) -> Array:
    points = [pose.pose.position for pose in message.poses]
    stretch = np.array([[p.x, p.y, p.z] for p in points], dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(stretch).all():
        raise EvaluationError(f"{path}: {CENTERLINE} has a point that is not finite")
    return stretch


def _add_cameras(
    bag: BagReader, settings: Settings, truth: Truth, thumbnails: Collection[int]
) -> None:
    """Add what the truth can do without: calibration, mounting and thumbnails."""
    try:
        topics = find_topics(str(bag.path), bag.topics, settings)
        left = camera_from_info(bag.first(topics.left_info))
        right = camera_from_info(bag.first(topics.right_info)) if topics.right_info else None
        truth.rig = stereo_rig(left, right)
    except (BagError, CalibrationError):
        truth.mounting = mounting_from_settings(settings)
        return
    truth.mounting = _mounting(bag, settings, topics)
    for record in bag.records([topics.left_image], complete=False) if thumbnails else ():
        if record.stamp_guess() in thumbnails:
            message = record.unpack()
            with suppress(ImageError):
                image = decode_image(message, settings.image)
                truth.thumbnails[stamp_ns(message.header)] = thumbnail(image)


def _mounting(bag: BagReader, settings: Settings, topics: ReplayTopics) -> Pose | None:
    """Return the true mounting: the bag's own, else what the settings say."""
    transforms = StaticTransforms()
    for record in bag.records([topics.transforms]) if topics.transforms else ():
        for transform in record.unpack().transforms:
            transforms.add(*transform_from_message(transform))
    frame = settings.frames.left_optical or bag.first(topics.left_image).header.frame_id
    found = transforms.between(settings.frames.base_link, frame)
    if found is not None:
        return found
    try:
        return find_mounting(settings, transforms, frame)
    except CalibrationError:
        return None
