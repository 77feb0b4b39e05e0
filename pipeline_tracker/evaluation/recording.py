"""What a bag with truth has of the recording itself: cameras, images, navigation.

It tells where the pipe falls into the images, and that the bag is the one that was replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.topics import find_topics
from pipeline_tracker.camera_info import camera_from_info
from pipeline_tracker.errors import BagError, CalibrationError, ImageError, MessageError
from pipeline_tracker.geometry.camera import StereoRig, stereo_rig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.images import decode_image
from pipeline_tracker.messages import (
    pose_from_message,
    stamp_ns,
    transform_from_message,
)
from pipeline_tracker.mounting import StaticTransforms, mounting_from_settings
from pipeline_tracker.rectification import StereoImages
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import Image
from pipeline_tracker.vectorization.vectorizer import thumbnail

_FOREVER = 1e9
_STATIC = "tf_static"


@dataclass
class Recording:
    """What a bag has beside the truth; any of it may be missing.

    Attributes:
        rig: the cameras, or None without calibration.
        mounting: base_link <- left optical frame, as the bag's static transforms give it, or None.
        images: stamps of the left images asked for that are there, ns; None without left images.
        thumbnails: left thumbnail by stamp, of those that can be decoded.
        poses: odom <- base_link, interpolated as a replay does it; None without the topic that
            was replayed.
    """

    rig: StereoRig | None = None
    mounting: Pose | None = None
    images: set[int] | None = None
    thumbnails: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    poses: PoseBuffer | None = None


@dataclass(frozen=True)
class _Topics:
    """Names of topics; empty where there is none."""

    image: str
    infos: tuple[str, str]
    transforms: str


def read_recording(
    bag: BagReader, settings: Settings, thumbnails: Collection[int] = ()
) -> Recording:
    """Read what a bag has of the recording.

    Args:
        bag: the bag.
        settings: the replay's settings; names of topics and frames.
        thumbnails: stamps of frames of which to make the left thumbnail, ns.

    Raises:
        BagError: the bag is damaged.
    """
    topics = _find_topics(bag, settings)
    recording = Recording(
        rig=_rig(bag, topics),
        mounting=_mounting(bag, settings, topics),
        poses=_poses(bag, settings),
    )
    if topics.image:
        recording.images = set()
        read = _reader(bag, settings, topics.infos[0])
        for record in bag.records([topics.image], complete=False) if thumbnails else ():
            if record.stamp_guess() in thumbnails:
                message = record.unpack()
                stamp = stamp_ns(message.header)
                recording.images.add(stamp)
                with suppress(ImageError):
                    recording.thumbnails[stamp] = thumbnail(read(message))
    return recording


def read_left_images(path: Path, settings: Settings, stamps: Collection[int]) -> dict[int, Image]:
    """Read some left images of a bag, as a replay saw them.

    Args:
        path: the bag.
        settings: the replay's settings.
        stamps: of the frames, ns.

    Returns:
        (H, W) uint8 by stamp; those that are missing or cannot be decoded are left out.

    Raises:
        BagError: the bag cannot be read.
    """
    images: dict[int, Image] = {}
    with BagReader(path) as bag:
        topics = _find_topics(bag, settings)
        if not topics.image or not stamps:
            return images
        read = _reader(bag, settings, topics.infos[0])
        for record in bag.records([topics.image], complete=False):
            if record.stamp_guess() in stamps:
                message = record.unpack()
                with suppress(ImageError):
                    images[stamp_ns(message.header)] = read(message)
    return images


def _find_topics(bag: BagReader, settings: Settings) -> _Topics:
    """Find topics: those that the replay says it has read, else as a replay finds them."""
    given = settings.topics
    image, infos = given.left_image, (given.left_info, given.right_info)
    if image not in bag.topics:
        if given.pose not in bag.topics:
            # Images are found without it too.
            given = given.model_copy(update={"pose": ""})
        with suppress(BagError):
            found = find_topics(
                str(bag.path), bag.topics, settings.model_copy(update={"topics": given})
            )
            image, infos = found.left_image, (found.left_info, found.right_info)
    static = [name for name in bag.topics if name.endswith(_STATIC)]
    left, right = (name if name in bag.topics else "" for name in infos)
    return _Topics(
        image if image in bag.topics else "", (left, right), min(static, key=len, default="")
    )


def _reader(bag: BagReader, settings: Settings, left_info: str) -> Callable[[Any], Image]:
    """Return what makes an image of a left image message, rectified where the replay did so."""
    if left_info and settings.camera.rectify:
        with suppress(BagError, CalibrationError):
            images = StereoImages(settings, bag.first(left_info))
            return partial(images.read, side="left")
    return partial(decode_image, settings=settings.image)


def _rig(bag: BagReader, topics: _Topics) -> StereoRig | None:
    left, right = topics.infos
    if not left:
        return None
    try:
        return stereo_rig(
            camera_from_info(bag.first(left)), camera_from_info(bag.first(right)) if right else None
        )
    except (BagError, CalibrationError):
        return None


def _mounting(bag: BagReader, settings: Settings, topics: _Topics) -> Pose | None:
    transforms = StaticTransforms()
    for record in bag.records([topics.transforms]) if topics.transforms else ():
        for transform in record.unpack().transforms:
            transforms.add(*transform_from_message(transform))
    frame = settings.frames.left_optical
    if not frame and topics.image:
        frame = bag.first(topics.image).header.frame_id
    return transforms.between(settings.frames.base_link, frame)


def _poses(bag: BagReader, settings: Settings) -> PoseBuffer | None:
    topic = settings.topics.pose
    if not topic or topic not in bag.topics:
        return None
    poses = PoseBuffer(settings.pose.max_gap, _FOREVER)
    for record in bag.records([topic], complete=False):
        with suppress(MessageError):
            poses.add(*pose_from_message(record.unpack()))
    return poses


def known_mounting(recording: Recording, settings: Settings) -> Pose | None:
    """Return the true mounting: the bag's own, else what the settings say; None: neither."""
    return recording.mounting or mounting_from_settings(settings)
