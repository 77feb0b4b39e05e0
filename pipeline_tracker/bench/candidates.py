"""What is timed at one size: our steps, and the stock methods in their place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, across
from pipeline_tracker.bench.recording import Recording, Stop, to_and_fro
from pipeline_tracker.bench.stock import StockMethods, draw_edges, pixel_hough
from pipeline_tracker.bench.timing import Candidate
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.pipe_segment import axis_of_segment
from pipeline_tracker.pipeline import FrameResult, Pipeline
from pipeline_tracker.recognition.hough import hough_lines
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import replace_settings
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import PipeSegment, State, VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer

Image = NDArray[np.uint8]

# Distance of votes, px at a width of 1200.
_DISTANCE, _REFERENCE_WIDTH = 6.0, 1200.0
_LEAST_SHARE = 0.08
VOTING_SEGMENTS = 600
# 21 headings x 21 pitches, two contours each: 882 lines.
_VOTING_SIDE, _VOTING_STEP = 21, 0.007


@dataclass(frozen=True)
class Round:
    """What all candidates of a round work on.

    Attributes:
        stop: the pair.
        vectorized: what the vectorizer makes of it.
        edges: the left image's segments as pixels, (H, W) uint8.
        axes: straight axes around the pipe's, for the vote.
        few: at most 600 segments of the left image, alone.
    """

    stop: Stop
    vectorized: VectorizedStereo
    edges: Image
    axes: list[Axis]
    few: VectorizedStereo


class Steps:
    """Our steps and their stock counterparts on one recording."""

    def __init__(self, recording: Recording, stock: StockMethods) -> None:
        """Args: recording, of the size to be measured; stock methods."""
        self._recording = recording
        self._stock = stock
        self._vectorizer = Vectorizer(recording.settings)
        self._distance = max(3.0, _DISTANCE * recording.size[0] / _REFERENCE_WIDTH)
        self.stock_steps: list[dict[str, float]] = []
        self.segments: list[int] = []

    def rounds(self) -> Iterator[Round]:
        """Yield what the rounds work on, without end."""
        recording = self._recording
        guide = Pipeline(recording.settings, recording.mounting)
        axis: Axis | None = None
        for stop in to_and_fro(recording):
            result = process_stop(guide, recording, stop)
            vectorized, segment = result.vectorized, result.tracked.segment
            self.segments.append(len(vectorized.left_segments))
            if segment is not None:
                axis = axis_of_segment(segment, recording.mounting)
            axes = [] if axis is None else _around(axis)
            edges = draw_edges(vectorized.left_segments, recording.size)
            yield Round(stop, vectorized, edges, axes, _few(vectorized))

    def candidates(self) -> list[Candidate[Round]]:
        """Return all that can be measured here."""
        return [
            *self._vectorizations(),
            Candidate("hough_modified", "lines: modified Hough", self._modified_hough),
            Candidate("hough_pixel", "lines: pixel Hough", self._pixel_hough),
            Candidate(
                "voting",
                f"voting: {VOTING_SEGMENTS} segments x {2 * _VOTING_SIDE**2} lines",
                self._vote,
                lambda work, _: bool(work.axes),
            ),
            *(self._recognition(technique) for technique in (1, 2, 3, 4, "auto")),
            self._tracking("tracking_vote", "tracking step, voting only", refine=False),
            self._tracking("tracking_fit", "tracking step, joint fit", refine=True),
            self._pair("pair_vote", "pair, voting only", {"tracking.refine": False}),
            self._pair("pair", "pair, joint fit", {}),
            self._pair("pair_recognition", "pair, recognised alone", {}, alone=True),
        ]

    def _vectorizations(self) -> Iterator[Candidate[Round]]:
        both = self._both
        yield Candidate("vectorize", "vectorize: ours", self._vectorize)
        yield Candidate("vectorize_match", "vectorize: ours, and matches", self._vectorize_match)
        yield Candidate(
            "stock", "vectorize: stock chain", partial(both, self._stock.chain), self._keep_steps
        )
        yield Candidate("lsd", "vectorize: CLAHE, LSD", partial(both, self._stock.lsd))
        if self._stock.has_edlines:
            edlines = partial(both, self._stock.edlines)
            yield Candidate("edlines", "vectorize: CLAHE, EDLines", edlines)
        hough_p = partial(both, self._stock.probabilistic_hough)
        yield Candidate("hough_p", "vectorize: CLAHE, Canny, HoughLinesP", hough_p)

    @staticmethod
    def _both(method: Any, work: Round) -> list[Any]:
        return [method(work.stop.pair.left), method(work.stop.pair.right)]

    def _keep_steps(self, _work: Round, answer: list[tuple[Any, dict[str, float]]]) -> bool:
        left, right = (steps for _, steps in answer)
        self.stock_steps.append({name: left[name] + right[name] for name in left})
        return True

    def _vectorize(self, work: Round) -> None:
        rig = StereoRig(self._recording.rig.left)
        for image in (work.stop.pair.left, work.stop.pair.right):
            self._vectorizer.process(work.stop.stamp_ns, rig, image, None)

    def _vectorize_match(self, work: Round) -> None:
        pair, rig = work.stop.pair, self._recording.rig
        self._vectorizer.process(work.stop.stamp_ns, rig, pair.left, pair.right)

    def _modified_hough(self, work: Round) -> Any:
        segments = work.vectorized.left_segments
        return hough_lines(
            segments, self._recording.size, distance=self._distance, least_share=_LEAST_SHARE
        )

    def _pixel_hough(self, work: Round) -> Any:
        least = round(_LEAST_SHARE * min(self._recording.size))
        return pixel_hough(work.edges, least)

    def _vote(self, work: Round) -> Any:
        return vote(work.few, work.axes, self._recording.settings.radius)

    def _recognition(self, technique: int | str) -> Candidate[Round]:
        settings = self._changed({"recognition.technique": technique})
        recognizer = Recognizer(settings, self._recording.mounting)

        def run(work: Round) -> PipeSegment:
            return recognizer.recognize(work.vectorized)

        label = (
            "recognition, auto" if technique == "auto" else f"recognition, technique {technique}"
        )
        return Candidate(f"recognition_{technique}", label, run, lambda _, found: bool(found.found))

    def _tracking(self, key: str, label: str, *, refine: bool) -> Candidate[Round]:
        settings = self._changed({"tracking.refine": refine})
        tracker = Tracker(settings, self._recording.mounting)
        recognizer = Recognizer(settings, self._recording.mounting)

        def run(work: Round) -> TrackedFrame | None:
            return tracker.begin(work.vectorized, work.stop.pair.pose)

        def settle(work: Round, answer: TrackedFrame | None) -> bool:
            if answer is None:
                tracker.finish(recognizer.recognize(work.vectorized))
            return answer is not None

        return Candidate(key, label, run, settle)

    def _pair(
        self, key: str, label: str, changes: dict[str, Any], *, alone: bool = False
    ) -> Candidate[Round]:
        pipeline = Pipeline(self._changed(changes), self._recording.mounting, alone)

        def run(work: Round) -> FrameResult:
            return process_stop(pipeline, self._recording, work.stop)

        def settle(_: Round, result: FrameResult) -> bool:
            found = result.tracked.status.state is State.TRACKING
            return found and (alone or result.recognition is None)

        return Candidate(key, label, run, settle)

    def _changed(self, changes: dict[str, Any]) -> Settings:
        return replace_settings(self._recording.settings, changes)


def process_stop(pipeline: Pipeline, recording: Recording, stop: Stop) -> FrameResult:
    """Give a pipeline the poses up to a pair, and the pair."""
    for stamp, pose in stop.poses:
        pipeline.poses.add(stamp, pose)
    return pipeline.process(stop.stamp_ns, recording.rig, stop.pair.left, stop.pair.right)


def _around(axis: Axis) -> list[Axis]:
    """Straight axes through a point in a grid of headings and pitches."""
    left, up = across(axis.direction, np.array([0.0, -1.0, 0.0]))
    steps = _VOTING_STEP * (np.arange(_VOTING_SIDE) - _VOTING_SIDE // 2)
    return [
        Axis.straight(axis.point, axis.direction + heading * left + pitch * up)
        for heading in steps
        for pitch in steps
    ]


def _few(frame: VectorizedStereo) -> VectorizedStereo:
    """The left image alone, with its longest segments."""
    segments = frame.left_segments
    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    longest = np.argsort(-lengths, kind="stable")[:VOTING_SEGMENTS]
    return replace(frame, rig=StereoRig(frame.rig.left), left_segments=segments[longest])
