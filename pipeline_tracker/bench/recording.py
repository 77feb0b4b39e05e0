"""The pairs that are measured with: those of a bag, resized, on an endless way to and fro."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import cv2
import numpy as np

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bench.options import Size
from pipeline_tracker.errors import BenchError
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose, interpolate
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.resources import demo_bag
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import load_settings, replace_settings
from pipeline_tracker.types import Image

# Pairs held at a time: at most so many, and so many bytes of them.
_MOST_PAIRS, _MOST_BYTES = 20, 256_000_000
_POSES_A_FRAME = 5
_DEMO_DIAMETER = "pipe.diameter=0.6"


@dataclass(frozen=True)
class RecordedPair:
    """A pair of images (H, W) uint8 with the vehicle's pose, odom <- base_link."""

    left: Image
    right: Image
    pose: Pose


@dataclass(frozen=True)
class Recording:
    """Consecutive pairs of one size.

    Attributes:
        name: the bag's.
        pairs: at least two.
        rig: the cameras, of the images' size.
        mounting: base_link <- left optical frame.
        settings: checked, with the mounting in them.
        period_ns: from pair to pair, ns.
    """

    name: str
    pairs: tuple[RecordedPair, ...]
    rig: StereoRig
    mounting: Pose
    settings: Settings
    period_ns: int

    @property
    def size(self) -> Size:
        """Width and height of the images, px."""
        return self.rig.left.width, self.rig.left.height

    def resized(self, size: Size) -> Recording:
        """Return the recording at another size: scaled to cover it, and cut about the middle."""
        if size == self.size:
            return self
        held = max(2, min(len(self.pairs), _MOST_BYTES // (2 * size[0] * size[1])))
        pairs = tuple(
            RecordedPair(_resize(pair.left, size), _resize(pair.right, size), pair.pose)
            for pair in self.pairs[:held]
        )
        right = self.rig.right
        rig = StereoRig(
            _resized_camera(self.rig.left, size),
            None if right is None else _resized_camera(right, size),
        )
        return replace(self, pairs=pairs, rig=rig)


@dataclass(frozen=True)
class Stop:
    """A pair on the way, and the poses since the one before.

    Attributes:
        number: counts from 0.
        stamp_ns: ns, period by period.
        pair: images and pose at the stamp.
        poses: stamps and poses after the stop before, up to this one's.
    """

    number: int
    stamp_ns: int
    pair: RecordedPair
    poses: tuple[tuple[int, Pose], ...]


def read_recording(bag: Path | None, overrides: tuple[str, ...] = ()) -> Recording:
    """Read the first pairs of a bag that have a pose.

    Args:
        bag: the bag; None: the demo, with its pipe's diameter.
        overrides: settings, ``key=value``.

    Raises:
        PipelineTrackerError: the bag or a setting cannot be used.
    """
    path = demo_bag() if bag is None else bag
    given = [_DEMO_DIAMETER, *overrides] if bag is None else list(overrides)
    with BagReader(path) as reader:
        settings = replace_settings(load_settings(None, given), {"recognition.only": False})
        source = ReplayInput(reader, settings)
        poses = PoseBuffer(settings.pose.max_gap)
        pairs: list[RecordedPair] = []
        stamps: list[int] = []
        rig: StereoRig | None = None
        for frame in source.frames(poses, poses.clear):
            pose = poses.at(frame.stamp_ns)
            if pose is None or frame.rig is None or frame.left is None or frame.right is None:
                continue
            if rig is not None and (frame.rig != rig or frame.stamp_ns <= stamps[-1]):
                break
            rig = frame.rig
            pairs.append(RecordedPair(frame.left, frame.right, pose))
            stamps.append(frame.stamp_ns)
            if len(pairs) >= max(2, min(_MOST_PAIRS, _MOST_BYTES // (2 * frame.left.size))):
                break
    if rig is None or len(pairs) < 2:
        raise BenchError(
            f"{path}: {len(pairs)} stereo pairs with a pose in a row, expected at least 2; name "
            "another bag with --images"
        )
    period = int(np.median(np.diff(stamps)))
    mounting, resolved = source.mounting, source.settings
    return Recording(path.name, tuple(pairs), rig, mounting, resolved, period)


def to_and_fro(recording: Recording) -> Iterator[Stop]:
    """Yield the pairs forward, backward, forward and so on without end.

    Each pair is a step away from the one before, so that the pipe can be tracked for ever; stamps
    go on by the recording's period.
    """
    pairs, period = recording.pairs, recording.period_ns
    last = len(pairs) - 1
    before = pairs[0].pose
    for number in count():
        place = number % (2 * last)
        pair = pairs[min(place, 2 * last - place)]
        stamp = number * period
        poses = [
            (stamp - period + step * period // _POSES_A_FRAME, step / _POSES_A_FRAME)
            for step in range(1, _POSES_A_FRAME)
        ]
        between = [(when, interpolate(before, pair.pose, share)) for when, share in poses]
        yield Stop(number, stamp, pair, (*between, (stamp, pair.pose)))
        before = pair.pose


def _scale_and_margin(width: int, height: int, size: Size) -> tuple[float, int, int]:
    """Return the scale that covers a size, and the pixels left over at the left and the top."""
    scale = max(size[0] / width, size[1] / height)
    return scale, (round(width * scale) - size[0]) // 2, (round(height * scale) - size[1]) // 2


def _resize(image: Image, size: Size) -> Image:
    height, width = image.shape
    scale, left, top = _scale_and_margin(width, height, size)
    full = round(width * scale), round(height * scale)
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    big = cv2.resize(image, full, interpolation=way)
    return np.ascontiguousarray(big[top : top + size[1], left : left + size[0]])


def _resized_camera(camera: Camera, size: Size) -> Camera:
    scale, left, top = _scale_and_margin(camera.width, camera.height, size)
    # Whole pixels: the two scales may differ from it by a rounding.
    sx = round(camera.width * scale) / camera.width
    sy = round(camera.height * scale) / camera.height
    return Camera(
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5 - left,
        cy=(camera.cy + 0.5) * sy - 0.5 - top,
        width=size[0],
        height=size[1],
        offset=camera.offset,
    )
