"""How time grows with pixels and with segments."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from pipeline_tracker.bench.candidates import Round, Steps, process_stop
from pipeline_tracker.bench.recording import Recording, Stop, to_and_fro
from pipeline_tracker.bench.schema import GrowthLine
from pipeline_tracker.bench.stock import StockMethods
from pipeline_tracker.bench.timing import Candidate, interleave
from pipeline_tracker.candidate_votes import vote
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.recognition.hough import hough_lines
from pipeline_tracker.types import Float32Array, State
from pipeline_tracker.vectorization.vectorizer import Vectorizer

# 3 : 2, each twice the pixels of the one before.
_SIZES = tuple((3 * side, 2 * side) for side in (107, 151, 213, 302, 427, 603, 853, 1206))
_COUNTS = (100, 200, 400, 800, 1600, 3200, 6400)
_ROUNDS = 7


def measure_growth(recording: Recording, size: tuple[int, int]) -> list[GrowthLine]:
    """Time our steps over sizes of images, and over numbers of segments.

    Args:
        recording: as read.
        size: at which segments are taken.
    """
    return [*_over_pixels(recording), *_over_segments(recording.resized(size))]


def _over_pixels(recording: Recording) -> list[GrowthLine]:
    medians: dict[str, list[float]] = {"vectorization of a pair": [], "tracked pair": []}
    pixels: dict[str, list[float]] = {name: [] for name in medians}
    for size in _SIZES:
        resized = recording.resized(size)
        found = interleave(_pair_candidates(resized), to_and_fro(resized), _ROUNDS)
        for name, times in found.items():
            # In small pictures the pipe may not be tracked.
            if times.median is not None:
                medians[name].append(times.median)
                pixels[name].append(float(size[0] * size[1]))
    return [_line(name, "pixels", pixels[name], ms) for name, ms in medians.items() if len(ms) > 1]


def _pair_candidates(recording: Recording) -> list[Candidate[Stop]]:
    vectorizer = Vectorizer(recording.settings)
    pipeline = Pipeline(recording.settings, recording.mounting)

    def vectorize(stop: Stop) -> object:
        pair = stop.pair
        return vectorizer.process(stop.stamp_ns, recording.rig, pair.left, pair.right)

    def track(stop: Stop) -> bool:
        result = process_stop(pipeline, recording, stop)
        return result.recognition is None and result.tracked.status.state is State.TRACKING

    return [
        Candidate("vectorization of a pair", "", vectorize),
        Candidate("tracked pair", "", track, lambda _, tracked: bool(tracked)),
    ]


def _over_segments(recording: Recording) -> list[GrowthLine]:
    work = _round_with_axes(recording)
    radius = recording.settings.radius
    fields = [_segments(work, count) for count in _COUNTS]

    def hough(segments: Float32Array) -> Callable[[Round], object]:
        return lambda _: hough_lines(segments, recording.size)

    def voting(segments: Float32Array) -> Callable[[Round], object]:
        frame = replace(work.few, left_segments=segments)
        return lambda w: vote(frame, w.axes, radius)

    makers = {"modified Hough": hough}
    if work.axes:
        makers[f"vote, {2 * len(work.axes)} lines"] = voting
    candidates = [
        Candidate(f"{name} {len(segments)}", "", make(segments))
        for name, make in makers.items()
        for segments in fields
    ]
    found = interleave(candidates, itertools.repeat(work), _ROUNDS)
    lines = []
    for name in makers:
        ms = [found[f"{name} {count}"].median or 0.0 for count in _COUNTS]
        lines.append(_line(name, "segments", [float(count) for count in _COUNTS], ms))
    return lines


def _round_with_axes(recording: Recording) -> Round:
    """Return the first round in which there are axes to vote on, of the first few."""
    rounds: Iterator[Round] = Steps(recording, StockMethods()).rounds()
    work = next(rounds)
    for _ in range(2 * len(recording.pairs)):
        if work.axes:
            break
        work = next(rounds)
    return work


def _segments(work: Round, count: int) -> Float32Array:
    """Return that many segments like those of a picture: some of them, or all again and again."""
    segments = work.vectorized.left_segments
    random = np.random.default_rng(count)
    if not len(segments):
        return np.zeros((count, 4), np.float32)
    chosen = np.concatenate(
        [random.permutation(len(segments)) for _ in range(-(-count // len(segments)))]
    )[:count]
    return np.ascontiguousarray(segments[chosen])


def _line(label: str, unit: str, x: list[float], ms: list[float]) -> GrowthLine:
    slope = np.polyfit(np.log(x), np.log(np.maximum(ms, 1e-6)), 1)[0]
    return GrowthLine(label=label, unit=unit, x=x, ms=ms, exponent=float(slope))
