"""The four steps in one call, frame by frame, in one process."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.echoes import EchoBuffer
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.self_check import SelfCheck, warm_up_check
from pipeline_tracker.settings import PipeSettings, Settings
from pipeline_tracker.settings_io import replace_settings
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import Image, PipeSegment, RelativeState, VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer


@dataclass(frozen=True)
class FrameResult:
    """All that was computed for one frame.

    Attributes:
        vectorized: segments, matches, thumbnails.
        recognition: the recognizer's answer; None where it was not asked.
        tracked: status, and the axis where there is one.
        relative_state: what the autopilot gets.
    """

    vectorized: VectorizedStereo
    recognition: PipeSegment | None
    tracked: TrackedFrame
    relative_state: RelativeState


class Pipeline:
    """Images and poses in, relative state out."""

    def __init__(self, settings: Settings, mounting: Pose, recognition_only: bool = False) -> None:
        """Set up the four steps.

        Args:
            settings: all settings.
            mounting: base_link <- left optical frame.
            recognition_only: recognise each frame by itself, track nothing.
        """
        self.poses = PoseBuffer(settings.pose.max_gap)
        self.echoes = EchoBuffer()
        self._vectorizer = Vectorizer(settings)
        self._recognizer = Recognizer(settings, mounting)
        self._tracker = Tracker(settings, mounting, recognition_only)
        self._estimator = RelativeStateEstimator(settings, mounting)
        self._check = SelfCheck(settings, mounting)

    def process(
        self,
        stamp_ns: int,
        rig: StereoRig,
        left: Image,
        right: Image | None,
        unseen: UnseenPair = SEEN_WHOLE,
    ) -> FrameResult:
        """Process one frame; poses and echoes around its stamp are to be known before.

        Args:
            stamp_ns: stamp of the left image, ns.
            rig: the cameras.
            left, right: rectified images, (H, W) uint8; right None in mono.
            unseen: what of them the cameras have not seen.
        """
        return self.follow(self._vectorizer.process(stamp_ns, rig, left, right, unseen))

    def follow(self, vectorized: VectorizedStereo, known: PipeSegment | None = None) -> FrameResult:
        """Process one frame whose images are vectorized already.

        Args:
            vectorized: the pair.
            known: what the recognizer answered for it before; asked anew where it is None.
        """
        stamp_ns = vectorized.stamp_ns
        recognition = None
        heard = self.echoes.take(stamp_ns, self.poses)
        tracked = self._tracker.begin(vectorized, self.poses.at(stamp_ns), heard)
        if tracked is None:
            # The recognizer has no memory: it would answer the same again.
            recognition = self._recognizer.recognize(vectorized) if known is None else known
            tracked = self._tracker.finish(recognition)
        state = self._estimator.update(tracked.status, tracked.segment, self.poses)
        tracked = replace(tracked, warnings=tracked.warnings + self._check.see(tracked))
        return FrameResult(vectorized, recognition, tracked, state)

    def reset(self, reason: str) -> None:
        """Forget everything, poses and echoes included (a backward time jump, for example)."""
        self.poses.clear()
        self.echoes.clear()
        self._tracker.reset(reason)
        self._estimator.reset()


# Told before the first warm-up after an install: it takes long, and nothing else is to be seen.
COMPILING = "compiling kernels, once after an install or an update: it takes a minute or two"


@functools.cache
def warm_up() -> None:
    """Compile or load every compiled kernel, so that the first frame is no slower than others.

    Runs all steps on a small made-up pair: a bright cylinder over a plane of noise, which is found,
    tracked, and found by each technique. A process needs it once.
    """
    radius, distance, focal = 0.3, 2.0, 200.0
    camera = Camera(focal, focal, 127.5, 95.5, 256, 192)
    rig = StereoRig(camera, replace(camera, offset=0.2))
    left, right = _made_up_pair(rig, radius, distance)
    mounting = Pose.from_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, -np.pi / 2])
    own = Settings(pipe=PipeSettings(diameter=2 * radius))
    changes: list[dict[str, Any]] = [{}, {"tracking.refine": False}]
    changes += [{"recognition.technique": technique} for technique in (1, 2, 3)]
    for change in changes:
        pipeline = Pipeline(replace_settings(own, change), mounting)
        for k in range(2):
            pipeline.poses.add(k, Pose.identity())
            pipeline.process(k, rig, left, right)
    warm_up_check()


def _made_up_pair(rig: StereoRig, radius: float, distance: float) -> tuple[Image, Image]:
    """Texture on a cylinder that lies on a plane, seen from above by both cameras."""
    noise = np.random.default_rng(0).normal(0.0, 20.0, (512, 512))
    # Smooth enough that halves of it look alike from both cameras.
    noise = 0.5 * (noise + np.roll(noise, 1, axis=0) + np.roll(noise, 1, axis=1))
    images: list[NDArray[np.uint8]] = []
    for camera in rig.cameras:
        ys, xs = np.mgrid[0 : camera.height, 0 : camera.width]
        u, v = (xs - camera.cx) / camera.fx, (ys - camera.cy) / camera.fy
        # Ray (offset + s u, s v, s) against the cylinder x² + (z - distance)² = radius².
        a = u * u + 1.0
        b = camera.offset * u - distance
        c = camera.offset**2 + distance**2 - radius**2
        root = b * b - a * c
        hit = root > 0
        s = np.where(hit, (-b - np.sqrt(np.maximum(root, 0.0))) / a, distance + radius)
        x, y = camera.offset + s * u, s * v
        texture = noise[(y * 100).astype(int) % 512, (x * 100).astype(int) % 512]
        grey = np.where(hit, 150.0, 90.0) + texture
        images.append(np.clip(grey, 0.0, 255.0).astype(np.uint8))
    return images[0], images[1]
