"""A frame with a past: where the pipe goes on, and what became of the frame (4.1)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.acceptance import refusal, score, support_share, too_uncertain
from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.echoes import PlacedEcho
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.travel import TravelDirection
from pipeline_tracker.limits import OverlapWatch, Sight
from pipeline_tracker.pipe_segment import (
    SegmentMaker,
    axis_of_segment,
    middle_of_view,
    published_covariance,
    turn_covariance,
)
from pipeline_tracker.refinement import refine
from pipeline_tracker.settings import Settings
from pipeline_tracker.support import Support, judge
from pipeline_tracker.surface import SurfacePoints, triangulate
from pipeline_tracker.tracking.candidates import best_candidate
from pipeline_tracker.tracking.mono_follower import MonoFollower
from pipeline_tracker.tracking.track import Track
from pipeline_tracker.types import (
    Mode,
    PipeSegment,
    State,
    TrackingStatus,
    VectorizedStereo,
)

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
_FORWARD = np.array([1.0, 0.0, 0.0])
_SECOND_NS = 1e9
# Covariance of the paper's discrete result: half a step of its grid and of its thresholds.
_DISCRETE_SIGMAS = np.array([0.02, 0.05, 0.01, 0.02])
# Without a fit that asks the surface, a candidate needs so much support.
_DISCRETE_SUPPORT = 0.3
# The vote's winner is tried first where it has that much more than the prediction.
_BETTER_VOTE = 1.15

PIPE_NOT_FOUND = "pipe_not_found"
NO_POSE = "no_pose"
POSE_JUMP = "pose_jump"


@dataclass(frozen=True)
class TrackedFrame:
    """What became of one frame.

    Attributes:
        status: state and reason.
        segment: the axis, tracked or coasted; None while searching.
        overlap: share of the pipe in view that the frame before showed too (5.3.1); None where it
            is not known.
        warnings: what the user should know, each told once.
        allowed: the time that a frame may take at this speed, s (5.3.1); None where it is not
            known.
        frame, pose: what was tracked, for checks afterwards; None where it was not seen.
    """

    status: TrackingStatus
    segment: PipeSegment | None
    overlap: float | None = None
    warnings: tuple[str, ...] = ()
    allowed: float | None = None
    frame: VectorizedStereo | None = None
    pose: Pose | None = None


@dataclass(frozen=True)
class _OpenFrame:
    """A frame that waits for its recognition."""

    frame: VectorizedStereo
    pose: Pose | None
    predicted: Track | None
    reason: str
    spent: float


@dataclass(frozen=True)
class _Found:
    """An axis that the pictures may bear."""

    axis: Axis
    covariance: Array
    support: Support


class Tracker:
    """Follows the pipe from frame to frame; the state machine searching, tracking, coasting."""

    def __init__(
        self,
        settings: Settings,
        mounting: Pose,
        recognition_only: bool = False,
        reset_counter: int = 0,
    ) -> None:
        """Start without a pipe.

        Args:
            settings: all settings.
            mounting: base_link <- left optical frame.
            recognition_only: recognise each frame by itself, track nothing.
            reset_counter: how often trackers before this one have forgotten their past.
        """
        self._settings = settings
        self._mounting = mounting
        self._recognition_only = recognition_only
        self._maker = SegmentMaker(settings, mounting)
        self._mono = MonoFollower(settings, mounting)
        self._to_optical = mounting.inverse()
        self._overlap = OverlapWatch(settings.motion.min_overlap)
        self._reset_counter = reset_counter
        self._forget()
        self._open: _OpenFrame | None = None

    @property
    def _joint_fit(self) -> bool:
        """Whether nobody asked for one of the paper's own techniques."""
        return self._settings.recognition.technique in {"auto", 4}

    @property
    def reset_counter(self) -> int:
        """How often the tracker has forgotten its past."""
        return self._reset_counter

    def change(self, settings: Settings) -> None:
        """Go on with other limits: of ``tracking``, ``motion`` and ``pose.max_speed``."""
        self._settings = settings
        self._overlap.least = settings.motion.min_overlap

    def reset(self, reason: str) -> None:
        """Forget everything; the next frame's reason tells why.

        Args:
            reason: in a word, for the next status.
        """
        self._forget()
        self._open = None
        self._reset_counter += 1
        self._pending_reason = reason

    def _forget(self) -> None:
        self._track: Track | None = None
        self._last: tuple[int, Pose] | None = None
        self._seen: tuple[int, Pose | None] | None = None
        self._travel = TravelDirection()
        self._mono.forget()
        self._pending_reason = ""

    def begin(
        self, frame: VectorizedStereo, pose: Pose | None, echoes: Sequence[PlacedEcho] = ()
    ) -> TrackedFrame | None:
        """Take in a frame and follow the pipe into it.

        Args:
            frame: the vectorized pair.
            pose: odom <- base_link at its stamp; None where it has none.
            echoes: what the echo sounder heard since the frame before; used with one camera.

        Returns:
            What became of it, or None where a recognition of this very frame is needed;
            ``finish`` then closes it.

        Raises:
            RuntimeError: the frame before was not closed.
        """
        if self._open is not None:
            raise RuntimeError("the frame before waits for its recognition; call finish first")
        start = time.perf_counter()
        if pose is not None and self._jumped(frame.stamp_ns, pose):
            self.reset(POSE_JUMP)
            # Heard before the jump: nobody knows where.
            echoes = ()
        self._mono.hear(echoes)
        if pose is None:
            # Without a pose there is nothing to carry the pipe along: the track ends here.
            self._track = None
            self._last = None
        predicted = self._predict(frame, pose)
        reason = self._pending_reason
        if predicted is not None and pose is not None:
            found, reason = self._follow(frame, predicted, pose)
            if found is not None:
                tracked = self._tracked(frame, pose, found, time.perf_counter() - start)
                return replace(tracked, frame=frame, pose=pose)
        self._open = _OpenFrame(frame, pose, predicted, reason, time.perf_counter() - start)
        return None

    def finish(self, recognition: PipeSegment | None, no_answer_reason: str = "") -> TrackedFrame:
        """Close the frame that ``begin`` left open.

        Args:
            recognition: the recognizer's answer for this frame; None where there was none.
            no_answer_reason: why there was none, in a word.

        Raises:
            RuntimeError: no frame is open.
        """
        if self._open is None:
            raise RuntimeError("no frame waits for a recognition; call begin first")
        start = time.perf_counter()
        opened, self._open = self._open, None
        closed = self._closed(opened, recognition, no_answer_reason, start)
        return replace(closed, frame=opened.frame, pose=opened.pose)

    def _closed(
        self,
        opened: _OpenFrame,
        recognition: PipeSegment | None,
        no_answer_reason: str,
        start: float,
    ) -> TrackedFrame:
        reason = no_answer_reason if recognition is None else PIPE_NOT_FOUND
        if recognition is not None and recognition.found:
            accepted: PipeSegment | None = recognition
            if opened.frame.rig.right is None and self._joint_fit:
                accepted, reason = self._weighed(opened, recognition)
            if accepted is not None:
                return self._recognized(opened, accepted, opened.spent, start)
        if opened.pose is None and recognition is not None:
            reason = f"{NO_POSE}, {reason}"
        elif opened.reason and opened.reason != reason:
            reason = f"{opened.reason}, {reason}" if reason else opened.reason
        return self._lost(opened, reason, opened.spent + time.perf_counter() - start)

    # The way of a frame with a past.

    def _jumped(self, stamp_ns: int, pose: Pose) -> bool:
        """Whether no motion can explain the pose since the last frame's."""
        if self._last is None:
            return False
        seconds = (stamp_ns - self._last[0]) / _SECOND_NS
        way = float(np.linalg.norm(pose.translation - self._last[1].translation))
        # 10 cm: the jitter of a pose at a high frame rate is no speed.
        return seconds > 0 and way > max(0.1, self._settings.pose.max_speed * seconds)

    def _predict(self, frame: VectorizedStereo, pose: Pose | None) -> Track | None:
        if self._recognition_only or pose is None or self._track is None:
            return None
        return self._track.moved_to(pose, frame.stamp_ns, self._mounting, frame.rig.left)

    def _vertical(self, pose: Pose | None) -> Array:
        """External vertical in the left optical frame; base_link's own without a pose."""
        up = _UP if pose is None else pose.rotation.T @ _UP
        vertical: Array = self._mounting.rotation.T @ up
        return vertical

    def _follow(
        self, frame: VectorizedStereo, predicted: Track, pose: Pose
    ) -> tuple[_Found | None, str]:
        """Vote over candidates, fit, and judge (4.1, steps 2 to 6)."""
        vertical = self._vertical(pose)
        matches = frame.matches if self._settings.ablation.surface else frame.matches[:0]
        surface = triangulate(matches, frame.rig)
        if not self._settings.tracking.refine:
            found = self._discrete(frame, surface, predicted, vertical)
            bears = self._bears(found) and support_share(found.support) >= _DISCRETE_SUPPORT
            return (found, "") if bears else (None, "too_little_contour")
        if frame.rig.right is None:
            return self._follow_mono(frame, predicted, pose)
        best: _Found | None = None
        reason = "fit_went_astray"
        prior = predicted.prior() if self._settings.ablation.prior else None
        for start in self._starts(frame, predicted, vertical):
            fit = refine(frame, surface, start, self._settings.radius, vertical, prior)
            if fit is None:
                continue
            support = judge(frame, surface, fit.axis, self._settings.radius)
            found = _Found(fit.axis, published_covariance(fit, support), support)
            if best is None or score(support) > score(best.support):
                best = found
            refused = refusal(support, frame.rig.right is not None, followed=True)
            if too_uncertain(found.covariance, float(np.linalg.norm(fit.axis.point))):
                refused = refused or "too_uncertain"
            if not refused and self._bears(found):
                return found, ""
            reason = refused or "too_little_support"
        return None, reason

    def _follow_mono(
        self, frame: VectorizedStereo, predicted: Track, pose: Pose
    ) -> tuple[_Found | None, str]:
        found, covariance, reason = self._mono.fit(
            frame, pose, predicted.axis, self._vertical(pose), predicted.prior()
        )
        if found is None or reason:
            return None, reason
        return _Found(found.fit.axis, covariance, found.support), ""

    def _weighed(
        self, opened: _OpenFrame, recognition: PipeSegment
    ) -> tuple[PipeSegment | None, str]:
        """Let the echoes have their say in what was recognised in one image; else why it is not."""
        start = axis_of_segment(recognition, self._mounting)
        found, covariance, reason = self._mono.fit(
            opened.frame, opened.pose, start, self._vertical(None)
        )
        if found is None or reason:
            return None, reason
        segment = self._maker.make(
            opened.frame,
            found.fit.axis,
            covariance,
            found.support,
            Mode.RECOGNITION,
            recognition.technique,
        )
        return segment, ""

    def _bears(self, found: _Found) -> bool:
        return support_share(found.support) >= self._settings.tracking.min_support

    def _starts(self, frame: VectorizedStereo, predicted: Track, vertical: Array) -> Iterator[Axis]:
        """Yield the prediction; should it fail, the winner of the vote where that has more."""
        axis = predicted.axis
        yield axis
        winner, votes = best_candidate(
            frame, axis.point, axis.direction, self._settings.radius, vertical
        )
        if votes > _BETTER_VOTE * float(vote(frame, [axis], self._settings.radius)[0]):
            yield winner

    def _discrete(
        self, frame: VectorizedStereo, surface: SurfacePoints, predicted: Track, vertical: Array
    ) -> _Found:
        """The paper's own result: the winning ray from the end of the previous piece."""
        half = 0.5 * self._settings.segment.length
        end = predicted.axis.at(half)
        axis, _ = best_candidate(
            frame, end, predicted.axis.direction, self._settings.radius, vertical
        )
        axis = axis.moved(middle_of_view(axis, frame.rig.left))
        support = judge(frame, surface, axis, self._settings.radius)
        return _Found(axis, np.diag(np.square(_DISCRETE_SIGMAS)), support)

    # Closing a frame.

    def _along_travel(
        self, axis: Axis, covariance: Array, stamp_ns: int, pose: Pose | None
    ) -> tuple[Axis, Array]:
        """Give an axis the direction of travel."""
        in_base = self._mounting.rotate(axis.direction)
        if pose is None:
            turn = float(in_base[0]) < 0.0
        else:
            motion = None
            if self._last is not None and stamp_ns > self._last[0]:
                way = pose.translation - self._last[1].translation
                seconds = (stamp_ns - self._last[0]) / _SECOND_NS
                if float(np.hypot(way[0], way[1])) > self._settings.motion.min_speed * seconds:
                    motion = way
            line = pose.rotate(in_base)
            direction, _ = self._travel.update(line, motion, pose.rotate(_FORWARD))
            turn = float(direction @ line) < 0.0
        if not turn:
            return axis, covariance
        signs = np.array([-1.0, 1.0, 1.0, -1.0])
        return axis.reversed(), covariance * np.outer(signs, signs)

    def _tracked(
        self, frame: VectorizedStereo, pose: Pose, found: _Found, spent: float
    ) -> TrackedFrame:
        axis, covariance = self._along_travel(found.axis, found.covariance, frame.stamp_ns, pose)
        support = found.support
        if axis is not found.axis:
            support = judge(
                frame, triangulate(frame.matches, frame.rig), axis, self._settings.radius
            )
        segment = self._maker.make(frame, axis, covariance, support, Mode.TRACKING, 0)
        track = Track(axis, covariance, pose, frame.stamp_ns)
        return self._keep(track, segment, "", spent, frame.rig.left)

    def _keep(
        self,
        track: Track | None,
        segment: PipeSegment,
        reason: str,
        spent: float,
        camera: Camera,
    ) -> TrackedFrame:
        """Close a frame in which the pipe was seen."""
        sight = self._sight_of(track, camera)
        self._track = track
        self._seen = (segment.stamp_ns, None if track is None else track.pose)
        self._last = None if track is None else (track.stamp_ns, track.pose)
        self._pending_reason = ""
        status = TrackingStatus(
            segment.stamp_ns,
            State.TRACKING,
            reason,
            segment.support,
            0.0,
            self._reset_counter,
            spent,
        )
        if sight is None:
            return TrackedFrame(status, segment)
        warnings = (sight.warning,) if sight.warning else ()
        return TrackedFrame(status, segment, sight.overlap, warnings, sight.allowed)

    def _sight_of(self, track: Track | None, camera: Camera) -> Sight | None:
        """How much of the pipe in view the frame before showed too, and what to say of it."""
        if track is None or self._last is None or track.stamp_ns <= self._last[0]:
            return None
        moved = self._to_optical.rotate(
            track.pose.rotation.T @ (track.pose.translation - self._last[1].translation)
        )
        way = float(moved @ track.axis.direction)
        seconds = (track.stamp_ns - self._last[0]) / _SECOND_NS
        return self._overlap.see(track.axis.point, track.axis.direction, way, seconds, camera)

    def _recognized(
        self, opened: _OpenFrame, recognition: PipeSegment, spent: float, start: float
    ) -> TrackedFrame:
        """Take over what the recognizer found, with the direction of travel and the vertical."""
        known = axis_of_segment(recognition, self._mounting)
        pose = opened.pose
        covariance = recognition.covariance
        if pose is not None:
            in_base = self._mounting.rotate(known.direction)
            covariance = turn_covariance(covariance, in_base, _UP, pose.rotation.T @ _UP)
        axis, covariance = self._along_travel(known, covariance, opened.frame.stamp_ns, pose)
        segment = replace(recognition, covariance=covariance)
        if axis is not known:
            segment = _reversed(segment)
        track = None
        if pose is not None and not self._recognition_only:
            track = Track(axis, covariance, pose, opened.frame.stamp_ns)
        reason = NO_POSE if pose is None else self._pending_reason
        spent += time.perf_counter() - start
        closed = self._keep(track, segment, reason, spent, opened.frame.rig.left)
        if pose is not None:
            self._last = (opened.frame.stamp_ns, pose)
        return closed

    def _lost(self, opened: _OpenFrame, reason: str, spent: float) -> TrackedFrame:
        """Close a frame in which the pipe was not seen: coast on the pose, or search."""
        stamp, pose, predicted = opened.frame.stamp_ns, opened.pose, opened.predicted
        since = -1.0 if self._seen is None else (stamp - self._seen[0]) / _SECOND_NS
        if pose is not None:
            self._last = (stamp, pose)
        self._pending_reason = ""
        segment = None
        state = State.SEARCHING
        if predicted is not None and pose is not None and self._may_coast(since, pose):
            state = State.COASTING
            self._track = predicted
            segment = self._coasted(opened.frame, predicted)
        else:
            self._track = None
        status = TrackingStatus(stamp, state, reason, 0.0, since, self._reset_counter, spent)
        return TrackedFrame(status, segment)

    def _may_coast(self, since: float, pose: Pose) -> bool:
        if self._seen is None or self._seen[1] is None:
            return False
        way = float(np.linalg.norm(pose.translation - self._seen[1].translation))
        tracking = self._settings.tracking
        return since <= tracking.max_coast_time and way <= tracking.max_coast

    def _coasted(self, frame: VectorizedStereo, predicted: Track) -> PipeSegment:
        empty = Support((), 0, 0.0, 0.0, 0.0)
        return self._maker.make(
            frame, predicted.axis, predicted.covariance, empty, Mode.TRACKING, 0
        )


def _reversed(segment: PipeSegment) -> PipeSegment:
    """The same segment travelled the other way: ends, left and right contours change places."""
    bits = int(segment.visible_contours)
    swapped = ((bits & 0b0101) << 1) | ((bits & 0b1010) >> 1)
    rows = [bit for bit in (1, 2, 4, 8) if bits & bit]
    order = [
        rows.index(bit << 1 if bit in {1, 4} else bit >> 1) for bit in (1, 2, 4, 8) if swapped & bit
    ]
    return replace(
        segment,
        start=segment.end,
        end=segment.start,
        visible_contours=type(segment.visible_contours)(swapped),
        contours=segment.contours[order] if order else segment.contours,
    )
