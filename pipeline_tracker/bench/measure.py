"""The figures of one size, and the shares of steps."""

from __future__ import annotations

import statistics
from collections.abc import Mapping

from pipeline_tracker.bench.candidates import Steps, process_stop
from pipeline_tracker.bench.recording import Recording, to_and_fro
from pipeline_tracker.bench.sampling import Profile, sample
from pipeline_tracker.bench.schema import SizeReport, Timing
from pipeline_tracker.bench.stock import StockMethods
from pipeline_tracker.bench.timing import Times, interleave
from pipeline_tracker.pipeline import Pipeline

_PROFILE_SECONDS = 3.0
_WARM_UP = 2


def measure_size(recording: Recording, stock: StockMethods, rounds: int) -> SizeReport:
    """Time everything at the size of a recording.

    Args:
        recording: resized.
        stock: the stock methods.
        rounds: how often each candidate is timed.
    """
    steps = Steps(recording, stock)
    candidates = steps.candidates()
    found = interleave(candidates, steps.rounds(), rounds, warm_up=_WARM_UP)
    timings = as_timings(found, {candidate.key: candidate.label for candidate in candidates})
    medians = {key: times.median for key, times in found.items()}
    matching = [
        both - alone
        for both, alone in zip(
            found["vectorize_match"].milliseconds, found["vectorize"].milliseconds, strict=True
        )
    ]
    stock_steps = steps.stock_steps[_WARM_UP:]
    return SizeReport(
        width=recording.size[0],
        height=recording.size[1],
        pairs=len(recording.pairs),
        segments=round(statistics.median(steps.segments)),
        pair_ms=medians["pair"],
        stock_pair_ms=medians["stock"],
        ratio=ratio(medians["stock"], medians["pair"]),
        hough_ratio=ratio(medians["hough_pixel"], medians["hough_modified"]),
        matching_ms=statistics.median(matching),
        stock_steps_ms={
            name: statistics.median(row[name] for row in stock_steps) for name in stock_steps[0]
        },
        timings=timings,
    )


def as_timings(found: Mapping[str, Times], labels: Mapping[str, str]) -> dict[str, Timing]:
    """Return the figures of each candidate, with their ratio to ``stock``."""
    stock = found["stock"].median
    return {
        key: Timing(
            label=labels[key],
            rounds=times.rounds,
            counted=len(times.milliseconds),
            min_ms=times.minimum,
            median_ms=times.median,
            p95_ms=times.quantile(0.95),
            ratio=ratio(stock, times.median),
        )
        for key, times in found.items()
    }


def ratio(stock: float | None, ours: float | None) -> float | None:
    """Return how many times as long the one takes as the other; None where either is not known."""
    return stock / ours if stock and ours else None


def profile_pair(recording: Recording, seconds: float = _PROFILE_SECONDS) -> Profile:
    """Sample where the time of tracked pairs goes.

    Args:
        recording: resized.
        seconds: how long.
    """
    pipeline = Pipeline(recording.settings, recording.mounting)
    way = to_and_fro(recording)
    for _ in range(_WARM_UP):
        process_stop(pipeline, recording, next(way))
    return sample(lambda: process_stop(pipeline, recording, next(way)), seconds)
