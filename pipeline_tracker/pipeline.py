"""The four steps in one call, frame by frame, in one process."""

from __future__ import annotations

import enum
import functools
import subprocess
import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.echoes import EchoBuffer
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.jit import kernels_are_kept
from pipeline_tracker.recognition.contours import contour_candidates, pair_hypotheses
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.recognition.surface_vote import vote_for_cylinders
from pipeline_tracker.refinement import refine
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.self_check import SelfCheck, warm_up_check
from pipeline_tracker.settings import PipeSettings, Settings
from pipeline_tracker.settings_io import replace_settings
from pipeline_tracker.support import judge
from pipeline_tracker.surface import triangulate
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import Image, PipeSegment, RelativeState, VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer, cores, thumbnail


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


class Stage(enum.Enum):
    """One of the four steps, where a process has it alone."""

    VECTORIZATION, RECOGNITION, TRACKING, RELATIVE_STATE = range(4)


@functools.cache
def warm_up(stage: Stage | None = None) -> None:
    """Compile or load every compiled kernel, so that the first frame is no slower than others.

    Runs all steps on a small made-up pair: a bright cylinder over a plane of noise, which is found,
    tracked, and found by each technique. A process needs it once.

    Where nothing is kept yet, all is compiled, whatever the stage; where there is a second core,
    another process compiles about half meanwhile. The kernels are kept in files that both read.

    Args:
        stage: the only one that this process has; None: all.
    """
    made_up = _MadeUp()
    if not kernels_are_kept():
        stage = None
        if cores() > 1:
            _compile_beside(made_up)
    if stage is None:
        # All that has been compiled is loaded; whatever has not is compiled now.
        made_up.run(None, _CHANGES)
    elif stage is Stage.VECTORIZATION:
        made_up.vectorize()
    elif stage is Stage.RECOGNITION:
        made_up.recognize(_CHANGES)
    elif stage is Stage.TRACKING:
        made_up.run(made_up.frame(), _CHANGES[:2])
    # The relative state has no kernels.
    if stage in {None, Stage.TRACKING}:
        warm_up_check()


def _compile_beside(made_up: _MadeUp) -> None:
    """Compile about half while another process compiles the rest."""
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; "
        "from pipeline_tracker.pipeline import warm_up_beside; warm_up_beside()"
    )
    quiet: Any = subprocess.DEVNULL
    other = subprocess.Popen(  # noqa: S603 - this very program
        [sys.executable, "-c", code], stdin=quiet, stdout=quiet, stderr=quiet
    )
    try:
        # First what the other process never comes to, then what it has done by then.
        made_up.fit()
        made_up.run(made_up.frame(), _CHANGES)
        other.wait()
    finally:
        other.kill()
        other.wait()


def warm_up_beside() -> None:
    """Compile what needs no fit: the search for the pipe, then what works on images."""
    made_up = _MadeUp()
    made_up.search()
    made_up.vectorize()
    warm_up_check()


# Settings with which the steps are run, so that each kernel is used.
_CHANGES: list[dict[str, Any]] = [
    {},
    {"tracking.refine": False},
    *({"recognition.technique": technique} for technique in (1, 2, 3)),
]


_LOOKING_DOWN = Pose.from_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, -np.pi / 2])


class _MadeUp:
    """A bright cylinder on a plane, seen from above by both cameras."""

    def __init__(self) -> None:
        self._radius, self._distance, focal = 0.3, 2.0, 200.0
        camera = Camera(focal, focal, 127.5, 95.5, 256, 192)
        self._rig = StereoRig(camera, replace(camera, offset=0.2))
        self._settings = Settings(pipe=PipeSettings(diameter=2 * self._radius))

    def run(self, frame: VectorizedStereo | None, changes: list[dict[str, Any]]) -> None:
        """Find and track the pipe with each of some settings, in a frame or, if None, in images."""
        left, right = (self._image(camera) for camera in self._rig.cameras)
        for change in changes:
            pipeline = Pipeline(replace_settings(self._settings, change), _LOOKING_DOWN)
            for k in range(2):
                pipeline.poses.add(k, Pose.identity())
                if frame is None:
                    pipeline.process(k, self._rig, left, right)
                else:
                    pipeline.follow(replace(frame, stamp_ns=k))

    def fit(self) -> None:
        """Fit the pipe's axis, where it is, and judge it."""
        frame = self.frame()
        surface = triangulate(frame.matches, self._rig)
        axis = Axis.straight(np.array([0.0, 0.0, self._distance]), np.array([0.0, 1.0, 0.0]))
        up = np.array([0.0, 0.0, -1.0])
        found = refine(frame, surface, axis, self._radius, up, by_contours=False)
        judge(frame, surface, axis if found is None else found.axis, self._radius)

    def search(self) -> None:
        """Look for pipes in the surface, and in the contours."""
        frame = self.frame()
        camera = self._rig.left
        vote_for_cylinders(triangulate(frame.matches, self._rig), self._radius, camera.width)
        lines = contour_candidates(frame.left_segments, camera)
        pair_hypotheses(lines, camera, self._radius)

    def recognize(self, changes: list[dict[str, Any]]) -> None:
        """Look for the pipe with each of some settings, in a frame."""
        frame = self.frame()
        for change in changes:
            settings = replace_settings(self._settings, change)
            Recognizer(settings, _LOOKING_DOWN).recognize(frame)

    def vectorize(self) -> None:
        """Vectorize the images."""
        left, right = (self._image(camera) for camera in self._rig.cameras)
        Vectorizer(self._settings).process(0, self._rig, left, right)

    def frame(self) -> VectorizedStereo:
        """Return about what the images would give, without looking at them."""
        left, right = self._rig.cameras
        ys, xs = np.mgrid[8 : left.height : 6, 40 : left.width : 6]
        depth = self._seen(left)[1][ys, xs]
        partner = xs - left.fx * right.offset / depth
        matches = np.stack((xs, ys, partner, ys), axis=-1).reshape(-1, 4).astype(np.float32)
        segments = []
        for camera in self._rig.cameras:
            towards = np.arctan2(-camera.offset, self._distance)
            half = np.arcsin(self._radius / np.hypot(camera.offset, self._distance))
            first, last = camera.cx + camera.fx * np.tan([towards - half, towards + half])
            # The brighter side is to the right.
            ends = [[first, y + 25, first, y] for y in range(0, 160, 30)]
            ends += [[last, y, last, y + 25] for y in range(0, 160, 30)]
            segments.append(np.array(ends, np.float32))
        one, other = (thumbnail(self._image(camera)) for camera in self._rig.cameras)
        return VectorizedStereo(0, self._rig, segments[0], segments[1], matches, one, other)

    def _seen(self, camera: Camera) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return where the cylinder is seen, and the depth, m, both (H, W)."""
        xs = np.tile(np.arange(camera.width), (camera.height, 1))
        u = (xs - camera.cx) / camera.fx
        # Ray (offset + s u, s v, s) against the cylinder x² + (z - distance)² = radius².
        a = u * u + 1.0
        b = camera.offset * u - self._distance
        c = camera.offset**2 + self._distance**2 - self._radius**2
        root = b * b - a * c
        hit = root > 0
        near = (-b - np.sqrt(np.maximum(root, 0.0))) / a
        return hit, np.where(hit, near, self._distance + self._radius)

    def _image(self, camera: Camera) -> Image:
        noise = np.random.default_rng(0).normal(0.0, 20.0, (512, 512))
        # Smooth enough that halves of it look alike from both cameras.
        noise = 0.5 * (noise + np.roll(noise, 1, axis=0) + np.roll(noise, 1, axis=1))
        ys, xs = np.mgrid[0 : camera.height, 0 : camera.width]
        hit, s = self._seen(camera)
        x, y = camera.offset + s * (xs - camera.cx) / camera.fx, s * (ys - camera.cy) / camera.fy
        texture = noise[(y * 100).astype(int) % 512, (x * 100).astype(int) % 512]
        grey = np.where(hit, 150.0, 90.0) + texture
        return np.asarray(np.clip(grey, 0.0, 255.0), np.uint8)
