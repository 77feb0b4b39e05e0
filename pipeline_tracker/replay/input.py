"""A bag as a stream of stereo frames, each after the poses that it needs.

What is held at a time is bounded: images that wait for their partner (``sync.queue``) and frames
that wait for a pose (``pose.max_gap`` of the bag's time), still packed as they came.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pipeline_tracker import messages
from pipeline_tracker.bags.reader import BagReader, BagRecord
from pipeline_tracker.bags.topics import ReplayTopics, find_topics
from pipeline_tracker.camera_info import calibration_of, is_rectified
from pipeline_tracker.echoes import Echo, EchoBuffer
from pipeline_tracker.errors import BagError, CalibrationError, ImageError, MessageError
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.mounting import (
    StaticTransforms,
    find_beam,
    find_mounting,
    mounting_as_settings,
)
from pipeline_tracker.rectification import StereoImages
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import replace_settings
from pipeline_tracker.sync import Matched, StereoSynchroniser
from pipeline_tracker.types import Image
from pipeline_tracker.validation.fields import check_stamp

# A stamp that goes back by more than this is a clock that was set back, not a late message.
JUMP_NS = SECOND_NS
BACKWARD = "time went backward"


@dataclass(frozen=True)
class Frame:
    """A left image and what came with it.

    Attributes:
        stamp_ns: stamp of the left image, ns.
        epoch: how often the bag's clocks were set back before it.
        reason: why it cannot be processed; empty where it can.
        rig, left, right: cameras and images; None where there is a reason, right None in mono.
        unseen: what of the images the cameras have not seen.
        left_info, right_info: the camera infos as they came; None where they describe other images
            than these, which were rectified.
    """

    stamp_ns: int
    epoch: int = 0
    reason: str = ""
    rig: StereoRig | None = None
    left: Image | None = None
    right: Image | None = None
    unseen: UnseenPair = SEEN_WHOLE
    left_info: Any = None
    right_info: Any = None


@dataclass
class InputCounts:
    """What was read and what could not be used, by reason."""

    poses: int = 0
    pings: int = 0
    echoes: int = 0
    refused_pings: int = 0
    first_refused_ping: str = ""
    unused_poses: Counter[str] = field(default_factory=Counter)
    first_invalid_pose: str = ""
    unreadable: Counter[str] = field(default_factory=Counter)
    alone: Counter[str] = field(default_factory=Counter)


@dataclass
class _Picture:
    """An image message, or why there is none."""

    message: Any
    reason: str = ""


class ReplayInput:
    """The input of a replay: an open bag, its topics, calibration and mounting.

    Attributes:
        topics: the topics that are read.
        settings: the settings with topics, pose type, frames and mounting filled in, so that they
            alone give the same run again.
        mounting: base_link <- left optical frame.
        left_frame: name of the left optical frame.
        frame_count: number of left images by the bag's summary.
        counts: filled while ``frames`` runs.
    """

    def __init__(self, bag: BagReader, settings: Settings) -> None:
        """Look into the bag.

        Raises:
            BagError: something that is needed is missing or not clear.
            CalibrationError: the calibration or the mounting is missing or impossible.
        """
        self._bag, self._settings = bag, settings
        self.topics = find_topics(str(bag.path), bag.topics, settings)
        self.counts = InputCounts()
        self.frame_count = bag.topics[self.topics.left_image].count
        self._infos = {"left": bag.first(self.topics.left_info)}
        if self.topics.right_image:
            self._infos["right"] = bag.first(self.topics.right_info)
        self._check_rectified()
        self._images: StereoImages | None = self._calibrate()
        self._bad_calibration = ""
        self.left_frame = settings.frames.left_optical or self._left_frame()
        transforms = self._static_transforms()
        found = find_mounting(settings, transforms, self.left_frame)
        self.settings = _resolved(settings, self.topics, self.left_frame, found)
        if self.topics.range:
            self._take_beam(transforms)
        # From the rounded angles of the settings, so that these give the same run again.
        self.mounting = find_mounting(self.settings, StaticTransforms(), self.left_frame)
        self._sync: StereoSynchroniser[_Picture] = StereoSynchroniser(
            settings.sync.tolerance, settings.sync.max_wait, settings.sync.queue
        )
        self._waiting: deque[tuple[Matched[_Picture], int]] = deque()
        self._newest: dict[str, int] = {}
        self._epoch = 0
        self._forget: Callable[[], None] = _nothing
        self._echoes = EchoBuffer()

    @property
    def rig(self) -> StereoRig | None:
        """The cameras by the newest calibration; None where that is impossible."""
        return None if self._images is None else self._images.rig

    def frames(
        self, poses: PoseBuffer, forget: Callable[[], None], echoes: EchoBuffer | None = None
    ) -> Iterator[Frame]:
        """Yield one frame for each left image, in the order of their stamps.

        Before a frame is yielded, the poses up to its stamp and the one after it are in ``poses``;
        a frame whose pose does not come within ``pose.max_gap`` of the bag's time goes without.

        Args:
            poses: filled with the bag's poses.
            forget: called where the clocks of the bag were set back: all before is past, ``poses``
                too.
            echoes: filled with what the echo sounder heard.

        Raises:
            BagError: the bag is damaged, after all frames before the damage were yielded.
        """
        self._forget = forget
        self._echoes = self._echoes if echoes is None else echoes
        topics = self.topics
        sides = {topics.left_image: "left", topics.right_image: "right"}
        infos = {topics.left_info: "left", topics.right_info: "right"}
        names = {*sides, *infos, topics.pose, topics.range} - {""}
        try:
            for record in self._bag.records(names):
                if record.topic in sides:
                    yield from self._take_image(record, sides[record.topic], poses)
                elif record.topic == topics.pose:
                    yield from self._take_pose(record, poses)
                elif record.topic == topics.range:
                    yield from self._take_range(record, poses)
                else:
                    yield from self._take_info(record, infos[record.topic], poses)
                yield from self._ready(poses, record.log_ns)
        finally:
            # Also when the bag is damaged: what was read before is whole.
            self._wait(self._sync.flush(), 0)
        yield from self._ready(poses, None)

    def rest(self, poses: PoseBuffer) -> Iterator[Frame]:
        """Yield the frames that still waited when reading ended with an error."""
        yield from self._ready(poses, None)

    def _take_image(self, record: BagRecord, side: str, poses: PoseBuffer) -> Iterator[Frame]:
        try:
            message = record.unpack()
            check_stamp(message.header)
            picture = _Picture(message)
            stamp = messages.stamp_ns(message.header)
        except (BagError, MessageError) as error:
            self.counts.unreadable[record.topic] += 1
            picture = _Picture(None, str(error))
            stamp = record.stamp_guess()
        yield from self._step_back(side, stamp, poses)
        if not self.topics.right_image:
            self._wait([self._mono(stamp, picture)], record.log_ns)
        elif side == "left":
            self._wait(self._sync.add_left(stamp, picture), record.log_ns)
        else:
            self._wait(self._sync.add_right(stamp, picture), record.log_ns)

    def _take_pose(self, record: BagRecord, poses: PoseBuffer) -> Iterator[Frame]:
        try:
            stamp, pose = messages.pose_from_message(record.unpack())
        except (BagError, MessageError) as error:
            self.counts.unused_poses["invalid"] += 1
            self.counts.first_invalid_pose = self.counts.first_invalid_pose or str(error)
            return
        yield from self._step_back("pose", stamp, poses)
        if poses.add(stamp, pose):
            self.counts.poses += 1
        else:
            self.counts.unused_poses["repeated or out of order"] += 1

    def _take_beam(self, transforms: StaticTransforms) -> None:
        """Find the beam, and put it into the settings."""
        frame = str(self._bag.first(self.topics.range).header.frame_id)
        origin, direction = find_beam(self.settings, transforms, frame)
        beam = {
            "altimeter.translation": origin.tolist(),
            "altimeter.direction": direction.tolist(),
        }
        self.settings = replace_settings(self.settings, beam)
        self._beam = find_beam(self.settings, StaticTransforms(), "")

    def _take_range(self, record: BagRecord, poses: PoseBuffer) -> Iterator[Frame]:
        try:
            stamp, distance, half_angle, sigma = messages.range_from_message(record.unpack())
        except BagError:
            self.counts.unreadable[record.topic] += 1
            return
        except MessageError as error:
            self.counts.refused_pings += 1
            self.counts.first_refused_ping = self.counts.first_refused_ping or str(error)
            return
        yield from self._step_back("range", stamp, poses)
        self.counts.pings += 1
        echo = None
        if distance is not None:
            least = self.settings.altimeter.sigma
            echo = Echo(stamp, *self._beam, distance, max(least, sigma), half_angle)
            self.counts.echoes += 1
        self._echoes.add(stamp, echo)

    def _take_info(self, record: BagRecord, side: str, poses: PoseBuffer) -> Iterator[Frame]:
        try:
            info = record.unpack()
        except BagError:
            self.counts.unreadable[record.topic] += 1
            return
        same = calibration_of(info) == calibration_of(self._infos[side])
        if not same:
            # A camera that was calibrated anew: what waits was taken before.
            yield from self._ready(poses, None)
        self._infos[side] = info
        if same:
            return
        try:
            self._images, self._bad_calibration = self._calibrate(), ""
        except CalibrationError as error:
            self._images, self._bad_calibration = None, str(error)

    def _step_back(self, kind: str, stamp: int, poses: PoseBuffer) -> Iterator[Frame]:
        """Settle all that is held when a clock was set back."""
        newest = self._newest.get(kind)
        if newest is not None and newest - stamp > JUMP_NS:
            self._wait(self._sync.reset(), 0)
            yield from self._ready(poses, None)
            self._newest.clear()
            self._epoch += 1
            self._forget()
        self._newest[kind] = max(stamp, self._newest.get(kind, stamp))

    def _mono(self, stamp: int, picture: _Picture) -> Matched[_Picture]:
        # Alone by intention: the synchroniser still drops what is repeated or late.
        out = [*self._sync.add_left(stamp, picture), *self._sync.flush()]
        return out[-1]

    def _wait(self, outcomes: list[Matched[_Picture]], log_ns: int) -> None:
        for outcome in outcomes:
            if outcome.reason and self.topics.right_image:
                self.counts.alone[outcome.reason] += 1
            if outcome.left is not None:
                self._waiting.append((outcome, log_ns))

    def _ready(self, poses: PoseBuffer, log_ns: int | None) -> Iterator[Frame]:
        """Yield the frames that need not wait for a pose any longer; all of them without a time."""
        patience = round(self.settings.pose.max_gap * SECOND_NS)
        while self._waiting:
            outcome, since = self._waiting[0]
            assert outcome.left is not None  # noqa: S101 - others don't wait
            stamp = outcome.left.stamp_ns
            settled = not self.topics.pose or poses.settled(stamp)
            settled = settled and (not self.topics.range or self._echoes.settled(stamp))
            overdue = log_ns is None or log_ns - since > patience
            if not (settled or overdue):
                return
            self._waiting.popleft()
            yield self._frame(outcome)

    def _frame(self, outcome: Matched[_Picture]) -> Frame:
        assert outcome.left is not None  # noqa: S101 - others don't wait
        stamp = outcome.left.stamp_ns
        mono = not self.topics.right_image
        reason = outcome.reason
        if mono and reason == "no_right_image":
            reason = ""
        images = self._images
        if not reason and images is None:
            reason = self._bad_calibration
        if reason or images is None:
            return Frame(stamp, self._epoch, reason)
        try:
            left = _read(images, outcome.left.item, "left")
            right = None if outcome.right is None else _read(images, outcome.right.item, "right")
        except ImageError as error:
            return Frame(stamp, self._epoch, str(error))
        return Frame(
            stamp_ns=stamp,
            epoch=self._epoch,
            rig=images.rig,
            left=left,
            right=right,
            unseen=images.unseen,
            left_info=self._infos["left"] if images.infos_hold else None,
            right_info=self._infos.get("right") if images.infos_hold else None,
        )

    def _calibrate(self) -> StereoImages:
        path, topics, infos = self._bag.path, self.topics, self._infos
        names = f"{path}: {topics.left_info}", f"{path}: {topics.right_info}"
        return StereoImages(self._settings, infos["left"], infos.get("right"), names)

    def _check_rectified(self) -> None:
        """Refuse pictures that are not rectified as they should be: straight lines are bent.

        Raises:
            CalibrationError: they are not, or they are and ought not to be.
        """
        left = self.topics.left_image
        if self._settings.camera.rectify:
            if self.topics.rectified and not self._settings.topics.left_image:
                raise CalibrationError(
                    f"{self._bag.path}: camera.rectify is set, but the images are rectified "
                    f"already ({left}), expected image_raw; leave camera.rectify out, or, if they "
                    f"are not rectified, say so with --set topics.left_image={left}"
                )
            return
        for side, info in self._infos.items():
            if not self.topics.rectified and not is_rectified(info):
                image = left if side == "left" else self.topics.right_image
                raise CalibrationError(
                    f"{self._bag.path}: {image} is not rectified (its camera info has distortion, "
                    "a rotation or another K than P), expected image_rect; rectify it with --set "
                    "camera.rectify=true, or, if the images are rectified, say so with --set "
                    f"topics.left_image={left}"
                )

    def _left_frame(self) -> str:
        frame = str(self._infos["left"].header.frame_id)
        if frame:
            return frame.lstrip("/")
        return str(self._bag.first(self.topics.left_image).header.frame_id).lstrip("/")

    def _static_transforms(self) -> StaticTransforms:
        transforms = StaticTransforms()
        if not self.topics.transforms:
            return transforms
        for record in self._bag.records([self.topics.transforms]):
            try:
                found = [messages.transform_from_message(t) for t in record.unpack().transforms]
            except (BagError, MessageError):
                self.counts.unreadable[record.topic] += 1
                continue
            for parent, child, pose in found:
                transforms.add(parent, child, pose)
        return transforms


def _resolved(
    settings: Settings, topics: ReplayTopics, left_frame: str, mounting: Pose
) -> Settings:
    changes: dict[str, Any] = {
        "topics.left_image": topics.left_image,
        "topics.right_image": topics.right_image,
        "topics.left_info": topics.left_info,
        "topics.right_info": topics.right_info,
        "topics.pose": topics.pose,
        "topics.range": topics.range,
        "pose_type": topics.pose_type,
        "frames.left_optical": left_frame,
    }
    if settings.camera.translation is None:
        changes |= mounting_as_settings(mounting)
    return replace_settings(settings, changes)


def _read(images: StereoImages, picture: _Picture, side: str) -> Image:
    if picture.message is None:
        raise ImageError(f"{side} image: {picture.reason}")
    return images.read(picture.message, side)


def _nothing() -> None:
    pass
