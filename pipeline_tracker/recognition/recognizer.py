"""A frame with no past: a piece of the pipe's axis, or none (4.2.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.acceptance import beyond_doubt, refusal, score, support_share, too_uncertain
from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipe_segment import SegmentMaker, published_covariance
from pipeline_tracker.recognition.closed_form import solve_by_technique
from pipeline_tracker.recognition.contours import contour_candidates, pair_hypotheses
from pipeline_tracker.recognition.surface_vote import vote_for_cylinders
from pipeline_tracker.refinement import refine
from pipeline_tracker.settings import Settings
from pipeline_tracker.support import Support, judge
from pipeline_tracker.surface import SurfacePoints, triangulate
from pipeline_tracker.types import Mode, PipeSegment, VectorizedStereo

Array = NDArray[np.float64]

# Hypotheses that are worth a fit, from either source.
_REFINED = 5
_JOINT_FIT = 4
# A technique of the paper that the user wants may be so much less sure: up to 4 cm near the pipe,
# of which most is what it is off the joint fit.
_ROOM_OF_TECHNIQUES = 1.5


@dataclass(frozen=True)
class Hypothesis:
    """An axis with what the pictures have for and against it."""

    axis: Axis
    covariance: Array
    support: Support

    @property
    def score(self) -> float:
        """What hypotheses are ranked by."""
        return score(self.support)


class Recognizer:
    """Finds the pipe in a frame by itself."""

    def __init__(self, settings: Settings, mounting: Pose) -> None:
        """Args: settings; mounting, base_link <- left optical frame."""
        self._settings = settings
        self._mounting = mounting
        self._maker = SegmentMaker(settings, mounting)
        self._radius = settings.radius
        # Without a pose base_link is taken as level.
        self._vertical = mounting.inverse().rotate(np.array([0.0, 0.0, 1.0]))

    def change(self, settings: Settings) -> None:
        """Go on with another ``recognition.min_support``."""
        self._settings = settings

    def recognize(self, frame: VectorizedStereo) -> PipeSegment:
        """Find the pipe in a vectorized frame.

        Returns:
            The piece of its axis in base_link, start to end along the vehicle's x axis; support 0
            where the pictures do not bear a pipe.
        """
        none = PipeSegment.none(frame.stamp_ns, self._radius)
        matches = frame.matches if self._settings.ablation.surface else frame.matches[:0]
        surface = triangulate(matches, frame.rig)
        best = self._best(frame, surface)
        if best is None or refusal(best.support, frame.rig.right is not None):
            return none
        if support_share(best.support) < self._settings.recognition.min_support:
            return none
        wanted = self._settings.recognition.technique
        technique = _JOINT_FIT if wanted == "auto" else wanted
        axis, covariance, allowed = best.axis, best.covariance, 1.0
        if technique != _JOINT_FIT:
            solved = solve_by_technique(
                technique, frame, surface, best.axis, self._radius, self._vertical
            )
            if solved is None:
                return none
            axis, covariance = solved
            allowed = _ROOM_OF_TECHNIQUES
        # One image alone seldom tells the distance: there the tracker decides, with the echoes.
        stereo = frame.rig.right is not None
        distance = float(np.linalg.norm(axis.point))
        if stereo and too_uncertain(covariance / allowed**2, distance):
            return none
        return self._maker.make(frame, axis, covariance, best.support, Mode.RECOGNITION, technique)

    def _best(self, frame: VectorizedStereo, surface: SurfacePoints) -> Hypothesis | None:
        """Fit the most promising hypotheses and keep the one that both kinds of evidence bear.

        Those from the surface come first; where one of them is beyond doubt, no other is tried.
        """
        best: Hypothesis | None = None
        for start, by_contours in self._starts(frame, surface):
            fit = refine(
                frame, surface, start, self._radius, self._vertical, by_contours=by_contours
            )
            if fit is None:
                continue
            support = judge(frame, surface, fit.axis, self._radius)
            found = Hypothesis(fit.axis, published_covariance(fit, support), support)
            if best is None or found.score > best.score:
                best = found
            if beyond_doubt(support):
                break
        return best

    def _starts(
        self, frame: VectorizedStereo, surface: SurfacePoints
    ) -> Iterator[tuple[Axis, bool]]:
        """Yield hypotheses along the vehicle's x axis, with whether they come from contours."""
        forward = self._mounting.inverse().rotate(np.array([1.0, 0.0, 0.0]))
        votes = vote_for_cylinders(surface, self._radius, frame.rig.left.width)
        for axis, _ in votes[:_REFINED]:
            yield _along(axis, forward), False
        for axis in self._best_contour_axes(frame):
            yield _along(axis, forward), True

    def _best_contour_axes(self, frame: VectorizedStereo) -> list[Axis]:
        axes = self._contour_axes(frame)
        order = np.argsort(-vote(frame, axes, self._radius), kind="stable")
        chosen: list[Axis] = []
        for axis in (axes[k] for k in order):
            if not any(_alike(axis, other, self._radius) for other in chosen):
                chosen.append(axis)
            if len(chosen) == _REFINED:
                break
        return chosen

    def _contour_axes(self, frame: VectorizedStereo) -> list[Axis]:
        axes: list[Axis] = []
        segments = (frame.left_segments, frame.right_segments)
        for number, camera in enumerate(frame.rig.cameras):
            lines = contour_candidates(segments[number], camera)
            pairs = pair_hypotheses(lines, camera, self._radius)
            axes += [axis for axis, _ in pairs]
        return axes


def _along(axis: Axis, forward: Array) -> Axis:
    return axis if float(axis.direction @ forward) >= 0 else axis.reversed()


def _alike(a: Axis, b: Axis, radius: float) -> bool:
    if abs(float(a.direction @ b.direction)) < 0.995:
        return False
    gap = np.cross(a.point - b.point, b.direction)
    return float(np.linalg.norm(gap)) < 0.3 * radius
