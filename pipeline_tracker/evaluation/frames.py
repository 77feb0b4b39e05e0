"""One frame of a replay against the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.evaluation.axis import Divergence, divergence
from pipeline_tracker.evaluation.contour_error import LineResult, measure_contours
from pipeline_tracker.evaluation.numbers import TrueFrame, wrapped_error
from pipeline_tracker.evaluation.replay import Estimate, Replay
from pipeline_tracker.evaluation.truth import Truth
from pipeline_tracker.evaluation.uncertainty import Uncertainty, segment_offsets, weigh
from pipeline_tracker.evaluation.view import View, pipe_in_view, true_contours
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.geometry.travel import TravelDirection

Array = NDArray[np.float64]

# A valid estimate is false beyond these: an end off the axis (near, and beyond FAR), the direction.
END_LIMIT, END_LIMIT_FAR, FAR = 0.05, 0.10, 3.0
DIRECTION_LIMIT = math.radians(3.0)
# Variances of the relative state, by the name of the table's column.
_VARIANCES = {
    "heading_misalignment": "heading_variance",
    "pitch_misalignment": "pitch_variance",
    "min_distance": "distance_variance",
    "approach_speed": "speed_variance",
}


@dataclass(frozen=True)
class FrameResult:
    """A frame, measured.

    Attributes:
        estimate: the row of the table.
        view: what of the pipe is in view.
        divergence: of the segment; None without a segment or without a pipe.
        direction_error: angle between segment and true axis, 0 to pi/2 rad; None likewise.
        errors: estimate less truth, by the name of the table's column; SI units.
        error_sigmas: standard deviations of these by the relative state, where it tells them.
        offsets: errors at the segment's middle, (4,), see ``segment_offsets``.
        uncertainty: how these stand to the covariance; None where it is not known.
        contours: the contour lines by name; None where the segment's message is not known.
        travelled: true way of the vehicle since the first frame, m.
        false_reasons: why a valid frame is false: ``no_pipe_in_view``, ``end``, ``direction``.
    """

    estimate: Estimate
    view: View
    divergence: Divergence | None = None
    direction_error: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    error_sigmas: dict[str, float] = field(default_factory=dict)
    offsets: Array | None = None
    uncertainty: Uncertainty | None = None
    contours: dict[str, LineResult] | None = None
    travelled: float = 0.0
    false_reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Motion:
    """True displacement of base_link in world, (3,), m, and its time, s."""

    way: Array
    duration: float


class Judge:
    """Measures the frames of a replay, to be given in time order."""

    def __init__(self, replay: Replay, truth: Truth) -> None:
        """Begin.

        Args:
            replay: the replay.
            truth: the truth; it has a pose for each frame of the replay.
        """
        self._replay = replay
        self._truth = truth
        self._radius = truth.radius or replay.settings.radius
        self._window = round(replay.settings.motion.window * SECOND_NS)
        self._travel = TravelDirection()
        self._previous: int | None = None
        self._reset_counter: int | None = None
        self._place: Array | None = None
        self._travelled = 0.0

    def judge(self, estimate: Estimate) -> FrameResult:
        """Measure the next frame.

        Raises:
            ValueError: the truth has no pose for it.
        """
        pose = self._truth.poses.at(estimate.stamp_ns)
        if pose is None:
            raise ValueError(f"no true pose at {estimate.stamp_ns} ns")
        self._forget_with_the_tracker(estimate.stamp_ns)
        motion = self._motion(estimate.stamp_ns, pose)
        result = FrameResult(
            estimate,
            pipe_in_view(self._truth, estimate.stamp_ns, pose, self._radius),
            travelled=self._travel_to(pose.translation),
        )
        if estimate.start is not None and estimate.end is not None and not self._truth.axis.empty:
            ends = pose.apply(np.stack((estimate.start, estimate.end)))
            result = self._measure(result, pose, motion, ends)
        return replace(result, false_reasons=self._false_reasons(result, pose))

    def _travel_to(self, place: Array) -> float:
        if self._place is not None:
            self._travelled += float(np.linalg.norm(place - self._place))
        self._place = place
        return self._travelled

    def _forget_with_the_tracker(self, stamp: int) -> None:
        """Begin anew where the tracker did: direction of travel and previous image."""
        state = self._replay.states.get(stamp)
        if state is not None and state.reset_counter != self._reset_counter:
            if self._reset_counter is not None:
                self._travel.reset()
                self._previous = None
            self._reset_counter = state.reset_counter

    def _motion(self, stamp: int, pose: Pose) -> _Motion | None:
        """Return the true S: over the window, or from the previous image if that is longer ago."""
        since = stamp - self._window
        if self._previous is not None and self._previous < since:
            since = self._previous
        # A left image without a partner is no image to the estimator either.
        if not self._replay.states or stamp in self._replay.states:
            self._previous = stamp
        before = self._truth.track.at(since)
        if before is None:
            return None
        return _Motion(pose.translation - before.translation, (stamp - since) / SECOND_NS)

    def _measure(
        self, result: FrameResult, pose: Pose, motion: _Motion | None, ends: Array
    ) -> FrameResult:
        way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        point, line = self._true_line(ends)
        stamp = result.estimate.stamp_ns
        forward = np.array([pose.rotation[0, 0], pose.rotation[1, 0], 0.0])
        moving = motion.way if motion is not None and self._is_moving(stamp, motion) else None
        if not result.estimate.has_pose:
            # Such a frame stands by itself: its angles are from the bow, with no past.
            moving = None
            direction = -line if float(line @ forward) < 0.0 else line
        else:
            direction, _ = self._travel.update(line, moving, forward)
        mounting = self._truth.mounting
        true = TrueFrame(
            point=point,
            direction=direction,
            radius=self._radius,
            pose=pose,
            camera=None if mounting is None else pose.apply(mounting.translation),
            way=forward if moving is None else moving,
            velocity=None if motion is None else motion.way / motion.duration,
        ).numbers()
        estimated = result.estimate.numbers
        result = self._uncertain(result, ends, line)
        return replace(
            result,
            divergence=divergence(ends[0], ends[1], self._truth.axis),
            direction_error=math.acos(min(1.0, abs(float(way @ line)))),
            errors={
                name: wrapped_error(name, value, true[name])
                for name, value in estimated.items()
                if name in true
            },
            error_sigmas=self._error_sigmas(stamp),
            contours=self._contours(stamp, pose, ends, way),
        )

    def _error_sigmas(self, stamp: int) -> dict[str, float]:
        state = self._replay.states.get(stamp)
        variances = {name: getattr(state, field, -1.0) for name, field in _VARIANCES.items()}
        return {name: math.sqrt(v) for name, v in variances.items() if v > 0.0}

    def _true_line(self, ends: Array) -> tuple[Array, Array]:
        """Return point and direction of the true axis beside an estimate.

        The chord between the feet of its two ends; the tangent at the middle's foot where the
        estimate lies across the pipe and the feet are one.
        """
        feet = [self._truth.axis.nearest(end) for end in ends]
        chord = feet[1] - feet[0]
        length = float(np.linalg.norm(chord))
        if length > np.linalg.norm(ends[1] - ends[0]) / 2.0:
            return feet[0], chord / length
        middle = ends.mean(axis=0)
        return self._truth.axis.nearest(middle), self._truth.axis.tangent(middle)

    def _is_moving(self, stamp: int, motion: _Motion) -> bool:
        """Whether angles are measured from the motion: as the estimate itself says, if it does."""
        speed = float(np.linalg.norm(motion.way[:2])) / motion.duration
        state = self._replay.states.get(stamp)
        if state is not None:
            return state.motion_observed and speed > 0.0
        return speed >= self._replay.settings.motion.min_speed and speed > 0.0

    def _uncertain(self, result: FrameResult, ends: Array, line: Array) -> FrameResult:
        """Add the errors at the segment's middle, and how they stand to the covariance."""
        foot = self._truth.axis.nearest(ends.mean(axis=0))
        offsets = segment_offsets(ends[0], ends[1], foot, line)
        segment = self._replay.segments.get(result.estimate.stamp_ns)
        if offsets is None or segment is None:
            return replace(result, offsets=offsets)
        return replace(result, offsets=offsets, uncertainty=weigh(offsets, segment.covariance))

    def _contours(
        self, stamp: int, pose: Pose, ends: Array, way: Array
    ) -> dict[str, LineResult] | None:
        segment = self._replay.segments.get(stamp)
        if segment is None:
            return None
        truths = tuple(
            true_contours(self._truth, stamp, pose, self._radius, image) for image in (0, 1)
        )
        listed = self._truth.axis.tangent(ends.mean(axis=0))
        return measure_contours(segment, truths, reverse=float(way @ listed) < 0.0)

    def _false_reasons(self, result: FrameResult, pose: Pose) -> tuple[str, ...]:
        """Say why a valid frame is false; nothing where it is true, or not valid."""
        if not result.estimate.valid:
            return ()
        reasons = []
        if result.view.in_view is False:
            reasons.append("no_pipe_in_view")
        if result.divergence is not None:
            far = self._distance(pose) > FAR
            if max(result.divergence.ends) > (END_LIMIT_FAR if far else END_LIMIT):
                reasons.append("end")
            if (result.direction_error or 0.0) > DIRECTION_LIMIT:
                reasons.append("direction")
        return tuple(reasons)

    def _distance(self, pose: Pose) -> float:
        """Distance from the left camera (base_link without a mounting) to the pipe's surface, m."""
        mounting = self._truth.mounting
        place = pose.translation if mounting is None else pose.apply(mounting.translation)
        return float(np.linalg.norm(self._truth.axis.nearest(place) - place)) - self._radius
