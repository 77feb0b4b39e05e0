"""The user's own numbers against what the pictures show, while running.

A wrong diameter, baseline, mounting or scale of the pose spoils every answer without a sign of it:
each is told once, with the figure, as soon as several frames leave no doubt.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline_tracker.acceptance import refusal
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipe_segment import axis_of_segment
from pipeline_tracker.recognition.surface_vote import vote_for_cylinders
from pipeline_tracker.self_check.series import Series
from pipeline_tracker.self_check.thickness import Thickness, measure_thickness
from pipeline_tracker.self_check.way import LEAST_AGREEMENT, Sight, seen_way, sight
from pipeline_tracker.settings import Settings
from pipeline_tracker.support import judge
from pipeline_tracker.surface import SurfacePoints, triangulate
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import State, VectorizedStereo
from pipeline_tracker.vectorization.working_size import working_factor

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
# Looked at in each of the first frames, then in each so many.
_FIRST, _THEN = 12, 8
# A thickness less sure than this share, or beyond these shares of the given one, tells nothing.
_LEAST_SURE, _SHARES = 0.05, (0.6, 1.7)
# What is off by less is not told: shares of thickness and way, rad, px at the working size.
_THICKNESS_SLACK, _WAY_SLACK, _TURN_SLACK, _ROW_SLACK = 0.025, 0.03, 0.017, 0.4
# Diameter and way off by shares that agree so well have one cause.
_SAME = 0.02
# Frames for which a wrong thickness waits for what the way has to say of it.
_PATIENCE = 25
# The way between two looks, in shares of the distance to the bed; more is hardly seen again.
_LEAST_WAY, _MOST_WAY, _MOST_TURN = 0.12, 0.5, 0.3


class SelfCheck:
    """Watches over diameter, baseline, mounting, poses and rows of a stereo pair."""

    def __init__(self, settings: Settings, mounting: Pose) -> None:
        """Start without measurements.

        Args:
            settings: all settings.
            mounting: base_link <- left optical frame.
        """
        self._diameter = settings.pipe.diameter
        self._mounting = mounting
        self._thickness = Series(1.0, _THICKNESS_SLACK, least=6, spread=0.04)
        self._way = Series(1.0, _WAY_SLACK, least=8, spread=0.05)
        self._turn = Series(0.0, _TURN_SLACK, least=8, spread=0.05)
        self._rows = Series(0.0, _ROW_SLACK, least=8, spread=0.4)
        self._frames = 0
        self._ways = 0
        self._waited = 0
        self._before: Sight | None = None
        self._resets = 0
        self._told: set[str] = set()

    def see(self, tracked: TrackedFrame) -> tuple[str, ...]:
        """Take in a closed frame.

        Args:
            tracked: what became of it.

        Returns:
            What has become sure with it, in words, each told once.
        """
        frame = tracked.frame
        if frame is None or frame.rig.right is None or not len(frame.matches):
            return ()
        self._frames += 1
        if tracked.status.reset_counter != self._resets:
            self._before, self._resets = None, tracked.status.reset_counter
        due = self._frames <= _FIRST or not self._frames % _THEN
        surface = None
        if due or (self._ways < _FIRST and tracked.pose is not None):
            surface = triangulate(frame.matches, frame.rig)
        if due and surface is not None:
            self._look_at_rows(frame)
            self._look_at_thickness(frame, surface, tracked)
        self._look_at_way(frame, surface, tracked.pose)
        return tuple(self._findings(frame, with_pose=tracked.pose is not None))

    # Looking.

    def _look_at_rows(self, frame: VectorizedStereo) -> None:
        apart = np.median(frame.matches[:, 3] - frame.matches[:, 1])
        self._rows.add(float(apart) / working_factor(frame.rig.left.width))

    def _look_at_thickness(
        self, frame: VectorizedStereo, surface: SurfacePoints, tracked: TrackedFrame
    ) -> None:
        found = self._measured(frame, surface, tracked)
        if found is None or not found.sigma < _LEAST_SURE * found.radius:
            return
        share = 2.0 * found.radius / self._diameter
        if not _SHARES[0] < share < _SHARES[1]:
            return
        # What is not as thick as it should be must be a pipe beyond doubt, not a hump of the bed.
        if abs(share - 1.0) > _THICKNESS_SLACK and refusal(
            judge(frame, surface, found.axis, found.radius), stereo=True
        ):
            return
        self._thickness.add(share)

    def _measured(
        self, frame: VectorizedStereo, surface: SurfacePoints, tracked: TrackedFrame
    ) -> Thickness | None:
        """Measure the pipe that was found; else what looks most like one."""
        radius = self._diameter / 2.0
        if tracked.status.state is State.TRACKING and tracked.segment is not None:
            start = axis_of_segment(tracked.segment, self._mounting)
        else:
            votes = vote_for_cylinders(surface, radius, frame.rig.left.width, most=1)
            if not votes:
                return None
            start = votes[0][0]
        up = _UP if tracked.pose is None else tracked.pose.rotation.T @ _UP
        vertical = self._mounting.rotation.T @ up
        return measure_thickness(surface, frame.rig.left, start, radius, vertical)

    def _look_at_way(
        self, frame: VectorizedStereo, surface: SurfacePoints | None, pose: Pose | None
    ) -> None:
        if pose is None:
            self._before = None
            return
        before = self._before
        if before is not None:
            change = self._mounting.inverse() @ pose.inverse() @ before.pose @ self._mounting
            reach = float(np.linalg.norm(change.translation)) / before.distance
            if reach < _LEAST_WAY:
                return
            turn = float(np.linalg.norm(Rotation.from_matrix(change.rotation).as_rotvec()))
            if reach < _MOST_WAY and turn < _MOST_TURN:
                self._ways += 1
                self._compare(before, frame, change)
            self._before = None
        if surface is not None:
            self._before = sight(surface, frame.left_thumbnail, pose)

    def _compare(self, before: Sight, frame: VectorizedStereo, change: Pose) -> None:
        """Compare the way by the pictures with that of the pose."""
        found = seen_way(
            before, frame.left_thumbnail, frame.rig.left, change, self._mounting.rotation[:2]
        )
        if found is None or found[1] < LEAST_AGREEMENT:
            return
        # How the vehicle moves in its own frame: the camera before, as seen from where it is now.
        by_pose = -self._mounting.rotate(change.translation)
        by_sight = -self._mounting.rotate(found[0])
        length = float(np.linalg.norm(by_sight))
        self._way.add(length / float(np.linalg.norm(by_pose)))
        if length > 0.0:
            turn, _ = Rotation.align_vectors(by_pose[None], by_sight[None])
            self._turn.add(turn.as_rotvec())

    # Telling.

    def _findings(self, frame: VectorizedStereo, *, with_pose: bool) -> Iterator[str]:
        thick, way = self._thickness.surely_off(), self._way.surely_off()
        if thick and not self._way.enough and with_pose and self._waited < _PATIENCE:
            # The way tells a wrong baseline from a wrong diameter: wait for it.
            self._waited += 1
            thick = False
        same = thick and way and self._same_cause()
        if same and self._tell("thickness", "way"):
            yield self._about_baseline(frame)
        if thick and self._tell("thickness"):
            yield self._about_diameter(frame)
        turned = self._turn.surely_off()
        # Along a way that is turned the pose's rotations do not fit either: its length says little.
        if way and not turned and self._tell("way"):
            yield self._about_way()
        if turned and self._tell("turn"):
            yield self._about_turn()
        if self._rows.surely_off() and self._tell("rows"):
            yield self._about_rows(frame)

    def _tell(self, *subjects: str) -> bool:
        """Whether none of these was told before; from now on they are."""
        if self._told & set(subjects):
            return False
        self._told |= set(subjects)
        return True

    def _same_cause(self) -> bool:
        return abs(float(self._thickness.median[0] / self._way.median[0]) - 1.0) < _SAME

    def _about_baseline(self, frame: VectorizedStereo) -> str:
        share, way = float(self._thickness.median[0]), float(self._way.median[0])
        return (
            f"the baseline is probably wrong: by stereo the pipe is {share:.3f} times as thick as "
            f"pipe.diameter={self._diameter:g}, and the way {way:.3f} times that of vnm/pose; a "
            f"baseline of {frame.rig.baseline / share:.4f} m in place of {frame.rig.baseline:.4f} "
            "m would explain both (P[0,3] of the right camera info is -fx * baseline)"
        )

    def _about_diameter(self, frame: VectorizedStereo) -> str:
        share = float(self._thickness.median[0])
        cause, also = "pipe.diameter is wrong", ""
        # The way goes with the baseline too: where it is right, so is the baseline.
        if not self._way.enough or self._way.surely_off():
            cause = "pipe.diameter or the baseline is wrong"
            also = (
                f", or a baseline of {frame.rig.baseline / share:.4f} m in place of "
                f"{frame.rig.baseline:.4f} m"
            )
        return (
            f"{cause}: the depths by stereo are those of a pipe {share:.3f} times as thick as "
            f"pipe.diameter={self._diameter:g} ({len(self._thickness)} frames); they suggest "
            f"pipe.diameter={share * self._diameter:.3f}{also}"
        )

    def _about_way(self) -> str:
        way = float(self._way.median[0])
        return (
            f"the scale of vnm/pose or the baseline is wrong: the pictures show {way:.3f} times "
            f"the way that vnm/pose tells ({len(self._way)} times measured); speeds and chainage "
            "are off by as much"
        )

    def _about_turn(self) -> str:
        turn = Rotation.from_rotvec(self._turn.median)
        mounting = Pose(turn.as_matrix() @ self._mounting.rotation, self._mounting.translation)
        numbers = ", ".join(f"{angle:.3f}" for angle in mounting.rpy())
        degrees = np.degrees(turn.magnitude())
        return (
            f"the mounting or vnm/pose is turned: the pictures show a way {degrees:.1f} degrees "
            f"off the one that vnm/pose tells ({len(self._turn)} times measured); it would be "
            f"explained by camera.rotation_rpy=[{numbers}], or by a pose that is not base_link's"
        )

    def _about_rows(self, frame: VectorizedStereo) -> str:
        factor = working_factor(frame.rig.left.width)
        apart = float(self._rows.median[0]) * factor
        where = "lower" if apart > 0.0 else "higher"
        return (
            f"the pair is not rectified to the same rows: what the left image shows is "
            f"{abs(apart):.1f} px {where} in the right one; calibrate the cameras anew"
        )
