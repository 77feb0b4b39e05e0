"""A stand-in for the pipeline: what it says follows from the grey level alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pipeline_tracker.echoes import EchoBuffer
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.settings import Settings
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import (
    Contours,
    Mode,
    PipeSegment,
    RelativeState,
    Side,
    State,
    TrackingStatus,
    VectorizedStereo,
)

BRIGHT = 100.0


class StandIn:
    """Finds a pipe in bright pictures; tracks where there is a pose and a pipe before."""

    def __init__(self, settings: Settings, mounting: Pose, recognition_only: bool = False) -> None:
        self.settings, self.mounting, self.recognition_only = settings, mounting, recognition_only
        self.poses = PoseBuffer(settings.pose.max_gap)
        self.echoes = EchoBuffer()
        self.calls: list[tuple[int, Pose | None]] = []
        self.rigs: list[StereoRig] = []
        self.unseen_pairs: list[UnseenPair] = []
        self.levels: list[tuple[float, float | None]] = []
        self.resets: list[str] = []
        self.known: list[bool] = []
        self.before: Callable[[int], None] = lambda _index: None
        self._tracked = False

    def reset(self, reason: str) -> None:
        self.poses.clear()
        self.resets.append(reason)
        self._tracked = False

    def process(
        self, stamp_ns: int, rig: StereoRig, left: Any, right: Any, unseen: UnseenPair = SEEN_WHOLE
    ) -> FrameResult:
        self.unseen_pairs.append(unseen)
        level = float(left.mean())
        self.levels.append((level, None if right is None else float(right.mean())))
        thumbnail = left[::8, ::8][: rig.left.height // 8, : rig.left.width // 8]
        vectorized = VectorizedStereo(
            stamp_ns=stamp_ns,
            rig=rig,
            left_segments=np.array([[1, 2, 30, 40]], np.float32),
            right_segments=np.zeros((0, 4), np.float32),
            # What is made of the images is all that later steps know of them.
            matches=np.full((int(right is not None), 4), [level / 16, 0, 0, 0], np.float32),
            left_thumbnail=thumbnail,
            right_thumbnail=thumbnail if right is not None else np.zeros((0, 0), np.uint8),
        )
        return self.follow(vectorized)

    def follow(self, vectorized: VectorizedStereo, known: PipeSegment | None = None) -> FrameResult:
        self.known.append(known is not None)
        self.before(len(self.calls))
        stamp_ns = vectorized.stamp_ns
        pose = self.poses.at(stamp_ns)
        self.calls.append((stamp_ns, pose))
        self.rigs.append(vectorized.rig)
        matches = vectorized.matches
        level = 16 * float(matches[0, 0]) if len(matches) else vectorized.left_thumbnail.mean()
        found = level > BRIGHT
        tracked = found and self._tracked and pose is not None and not self.recognition_only
        self._tracked = found and pose is not None
        resets = len(self.resets)
        if not found:
            status = TrackingStatus(stamp_ns, State.SEARCHING, "too dark", 0.0, -1.0, resets)
            state = RelativeState(stamp_ns, False, 0.0, resets)
            none = PipeSegment.none(stamp_ns, 0.3)
            return FrameResult(vectorized, none, TrackedFrame(status, None), state)
        segment = self._segment(stamp_ns, level, tracked=tracked)
        reason = "" if pose is not None else "no_pose"
        status = TrackingStatus(stamp_ns, State.TRACKING, reason, segment.support, 0.0, resets)
        state = self._state(stamp_ns, level, pose, resets)
        recognition = None if tracked else segment
        return FrameResult(vectorized, recognition, TrackedFrame(status, segment), state)

    def _segment(self, stamp_ns: int, level: float, *, tracked: bool) -> PipeSegment:
        return PipeSegment(
            stamp_ns=stamp_ns,
            mode=Mode.TRACKING if tracked else Mode.RECOGNITION,
            technique=0 if tracked else 2,
            start=np.array([1.0, level / 1000.0, -2.0]),
            end=np.array([1.5, level / 1000.0, -2.0]),
            radius=self.settings.radius,
            covariance=np.eye(4) * 1e-4,
            support=float(np.float32(0.5)),
            visible_contours=Contours.LEFT_IMAGE_LEFT,
            contours=np.array([[10, 0, 10, 47]], np.float32),
        )

    def _state(self, stamp_ns: int, level: float, pose: Pose | None, resets: int) -> RelativeState:
        return RelativeState(
            stamp_ns=stamp_ns,
            valid=True,
            quality=level / 255.0,
            reset_counter=resets,
            heading_misalignment=-0.1,
            pitch_misalignment=0.01,
            min_distance=1.7,
            min_distance_base=1.6,
            approach_speed=0.0 if pose is None else 0.02,
            lateral_offset=-1e-12,
            vertical_offset=2.0,
            side=Side.ALONG,
            motion_observed=pose is not None,
            upper_point=np.array([1.25, 0.0, -1.7]),
            upper_point_vertical=np.array([1.25, 0.0, -1.69]),
            chainage=0.0 if pose is None else float(pose.translation[0]),
            heading_variance=1e-4,
            pitch_variance=1e-4,
            distance_variance=1e-4,
            speed_variance=-1.0 if pose is None else 1e-4,
        )
