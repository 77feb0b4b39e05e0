"""From a segment and the vehicle's poses to the relative state (4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.geometry.travel import TravelDirection
from pipeline_tracker.relative_state.axis import LevelAxis, elevation, turn_between
from pipeline_tracker.relative_state.chainage import Chainage
from pipeline_tracker.relative_state.motion import Motion, heading_rotation
from pipeline_tracker.relative_state.side import mirrored, side_from_contours, side_from_offset
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import PipeSegment, RelativeState, Side, State, TrackingStatus

Array = NDArray[np.float64]

_FORWARD = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Frame:
    """What one frame brings: pose and motion (None where they are not known)."""

    pose: Pose | None
    motion: Motion | None

    @property
    def heading(self) -> Array:
        """Rotation odom <- levelled base_link, 3 x 3."""
        return np.eye(3) if self.pose is None else heading_rotation(self.pose)

    @property
    def levelling(self) -> Array:
        """Rotation levelled base_link <- base_link; base_link is taken as level without a pose."""
        return np.eye(3) if self.pose is None else self.heading.T @ self.pose.rotation

    @property
    def moving(self) -> Motion | None:
        """The motion, where it has a direction."""
        return self.motion if self.motion is not None and self.motion.observed else None


class RelativeStateEstimator:
    """Gives the relative state of each frame; remembers direction, side and way from the past."""

    def __init__(self, settings: Settings, mounting: Pose) -> None:
        """Start without a past.

        Args:
            settings: ``motion.window`` and ``motion.min_speed`` are used.
            mounting: base_link <- left optical frame.
        """
        self.change(settings)
        self._camera = mounting.translation
        self._reset_counter: int | None = None
        self.reset()

    def change(self, settings: Settings) -> None:
        """Go on with another ``motion.window`` and ``motion.min_speed``."""
        self._window = round(settings.motion.window * SECOND_NS)
        self._min_speed = settings.motion.min_speed

    def reset(self) -> None:
        """Forget the past: direction of travel, side, chainage and the previous image."""
        self._travel = TravelDirection()
        self._chainage = Chainage()
        self._side = Side.NOT_IN_VIEW
        self._previous: tuple[int, Pose | None] | None = None
        self._position: Array | None = None

    def set_reference(self) -> bool:
        """Set the chainage to 0 where the vehicle is now; it grows in the direction of travel.

        Returns:
            Whether it is known where that is: at the last image with a pose. Else it is 0 where
            the pipe is seen next.
        """
        self._chainage.set_reference(self._position)
        return self._position is not None

    def update(
        self, status: TrackingStatus, segment: PipeSegment | None, poses: PoseBuffer
    ) -> RelativeState:
        """Compute the relative state of one frame; every frame is to be given, in order.

        Args:
            status: what became of the frame; a new ``reset_counter`` makes the estimator forget
                its past.
            segment: the axis in base_link, tracked or coasted; None while searching.
            poses: poses of base_link in odom up to the frame's stamp.

        Returns:
            The relative state. All its numbers are finite; what is not known is 0, its variance -1.
            Heading, offsets, side (ALONG) and upper points of a vertical pipe are such: they are 0
            and ``heading_variance`` is -1. Not valid where the segment puts the camera inside the
            pipe (``min_distance`` is then not above 0).

        Raises:
            ValueError: status and segment are of different frames.
        """
        if segment is not None and segment.stamp_ns != status.stamp_ns:
            raise ValueError(
                f"segment of {segment.stamp_ns} ns with the status of {status.stamp_ns} ns: "
                "expected the same frame"
            )
        if self._reset_counter is not None and status.reset_counter != self._reset_counter:
            self.reset()
        self._reset_counter = status.reset_counter
        frame = self._observe(status.stamp_ns, poses)
        if status.state == State.SEARCHING or segment is None or not _usable(segment):
            self._side = Side.NOT_IN_VIEW
            seen = (
                Side.NOT_IN_VIEW
                if segment is None
                else side_from_contours(segment.visible_contours)
            )
            return RelativeState(status.stamp_ns, False, 0.0, status.reset_counter, side=seen)
        return self._describe(status, segment, frame)

    def _observe(self, stamp_ns: int, poses: PoseBuffer) -> _Frame:
        """Find pose and motion, and remember this image as the previous one."""
        pose, previous = poses.at(stamp_ns), self._previous
        self._previous = stamp_ns, pose
        if pose is None:
            return _Frame(None, None)
        self._position = pose.translation
        since, before = stamp_ns - self._window, None
        if previous is not None and previous[0] < since and previous[1] is not None:
            since, before = previous
        if before is None:
            before = poses.at(since)
        if before is None:
            return _Frame(pose, None)
        duration = (stamp_ns - since) / SECOND_NS
        return _Frame(pose, Motion.between(before, pose, duration, self._min_speed))

    def _describe(
        self, status: TrackingStatus, segment: PipeSegment, frame: _Frame
    ) -> RelativeState:
        axis = self._axis(segment, frame)
        camera = frame.levelling @ self._camera
        # S, or the vehicle's levelled x axis.
        moving = frame.moving
        s = _FORWARD if moving is None else moving.way
        lateral, vertical = axis.offsets()
        valid = status.state == State.TRACKING and axis.distance(camera) > 0.0
        heading_variance, pitch_variance = _angle_variances(axis, moving)
        speed, speed_variance = _approach(axis, frame.motion)
        q, q_vertical = _upper_points(axis, frame)
        return RelativeState(
            stamp_ns=status.stamp_ns,
            valid=valid,
            quality=float(np.float32(min(1.0, segment.support))) if valid else 0.0,
            reset_counter=status.reset_counter,
            heading_misalignment=0.0 if axis.vertical else turn_between(s, axis.direction),
            pitch_misalignment=elevation(axis.direction) - elevation(s),
            min_distance=axis.distance(camera),
            min_distance_base=axis.distance(np.zeros(3)),
            approach_speed=speed,
            lateral_offset=lateral,
            vertical_offset=vertical,
            side=self._judge_side(lateral, axis.radius, frame),
            motion_observed=moving is not None,
            upper_point=q,
            upper_point_vertical=q_vertical,
            chainage=self._advance(axis, frame),
            heading_variance=heading_variance,
            pitch_variance=pitch_variance,
            distance_variance=axis.distance_variance(camera),
            speed_variance=speed_variance,
        )

    def _axis(self, segment: PipeSegment, frame: _Frame) -> LevelAxis:
        """Level the line through the segment and give it the direction of travel."""
        start, end = frame.levelling @ segment.start, frame.levelling @ segment.end
        line = (end - start) / np.linalg.norm(end - start)
        heading, moving = frame.heading, frame.moving
        turned = False
        if frame.pose is None:
            # Without a pose a frame stands by itself: nothing carries a direction over to it.
            direction = line if line[0] >= 0.0 else -line
        else:
            motion = None if moving is None else heading @ moving.way
            fixed, turned = self._travel.update(heading @ line, motion, heading @ _FORWARD)
            direction = line if float(fixed @ (heading @ line)) > 0.0 else -line
        if turned:
            self._side = mirrored(self._side)
        covariance = segment.covariance
        known = np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all()
        # Turned end for end, left and pitch change their sign.
        signs = np.array([-1.0, 1.0, 1.0, -1.0] if float(direction @ line) < 0.0 else [1.0] * 4)
        return LevelAxis(
            middle=(start + end) / 2.0,
            direction=direction,
            radius=segment.radius,
            covariance=covariance * np.outer(signs, signs) if known else None,
        )

    def _judge_side(self, lateral: float, radius: float, frame: _Frame) -> Side:
        if frame.pose is None:
            return side_from_offset(lateral, radius)
        self._side = side_from_offset(lateral, radius, self._side)
        return self._side

    def _advance(self, axis: LevelAxis, frame: _Frame) -> float:
        if frame.pose is None:
            return 0.0
        return self._chainage.advance(frame.pose.translation, frame.heading @ axis.direction)


def _usable(segment: PipeSegment) -> bool:
    ends = np.concatenate((segment.start, segment.end))
    return bool(np.isfinite(ends).all()) and not np.allclose(
        segment.start, segment.end, rtol=0.0, atol=1e-6
    )


def _angle_variances(axis: LevelAxis, moving: Motion | None) -> tuple[float, float]:
    """Variances of heading and pitch misalignment: those of D and of S, taken as independent."""
    if axis.covariance is None or axis.vertical:
        return -1.0, -1.0
    heading, pitch = float(axis.covariance[2, 2]), float(axis.covariance[3, 3])
    if moving is None:
        return heading, pitch
    return heading + moving.heading_variance, pitch + moving.pitch_variance


def _approach(axis: LevelAxis, motion: Motion | None) -> tuple[float, float]:
    """Approach speed and its variance; a vehicle that hovers has one too.

    Where the axis's covariance is not known, the variance is that of the motion alone: -1 is kept
    for a speed that is not known.
    """
    speed = None if motion is None else axis.approach_speed(motion.velocity)
    if motion is None or speed is None:
        return 0.0, -1.0
    return speed, motion.speed_variance + max(0.0, axis.speed_variance(motion.velocity))


def _upper_points(axis: LevelAxis, frame: _Frame) -> tuple[Array, Array]:
    """Q and Q' in base_link; 0 for a vertical pipe."""
    points = axis.upper_points()
    if points is None:
        return np.zeros(3), np.zeros(3)
    return frame.levelling.T @ points[0], frame.levelling.T @ points[1]
