"""Turns, medians and the one thread."""

from __future__ import annotations

import itertools
import os

import cv2
import pytest

from pipeline_tracker.bench.measure import as_timings, ratio
from pipeline_tracker.bench.timing import Candidate, Times, interleave, one_thread


def test_candidates_take_turns_and_each_is_first_once() -> None:
    order: list[tuple[str, int]] = []
    candidates = [
        Candidate[int](key, key, lambda work, key=key: order.append((key, work))) for key in "abc"
    ]
    found = interleave(candidates, itertools.count(), 2, warm_up=1)
    expected = [("abc", 0), ("bca", 1), ("cab", 2)]
    assert order == [(key, work) for keys, work in expected for key in keys]
    assert list(found) == ["a", "b", "c"]
    assert {times.rounds for times in found.values()} == {2}


def test_only_rounds_that_settle_count_and_settling_is_not_timed() -> None:
    now = [0.0]

    def run(work: int) -> int:
        now[0] += 1e-3 * (work + 1)
        return work

    def settle(_: int, answer: int) -> bool:
        now[0] += 100.0
        return answer % 2 == 1

    candidate = Candidate[int]("a", "a", run, settle)
    found = interleave([candidate], itertools.count(), 6, warm_up=0, clock=lambda: now[0])["a"]
    assert found.rounds == 6
    assert found.milliseconds == pytest.approx([2.0, 4.0, 6.0])
    assert found.minimum == pytest.approx(2.0)
    assert found.median == pytest.approx(4.0)
    assert found.quantile(0.95) == pytest.approx(5.8)


def test_what_never_counts_has_no_figures() -> None:
    found = {"stock": Times([8.0, 10.0, 12.0], 3), "ours": Times([], 3)}
    timings = as_timings(found, {"stock": "stock", "ours": "ours"})
    assert timings["stock"].ratio == 1.0
    assert timings["ours"].model_dump() == {
        "label": "ours", "rounds": 3, "counted": 0,
        "min_ms": None, "median_ms": None, "p95_ms": None, "ratio": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("stock", "ours", "expected"),
    [(200.0, 20.0, 10.0), (None, 20.0, None), (200.0, None, None), (200.0, 0.0, None)],
)
def test_ratio(stock: float | None, ours: float | None, expected: float | None) -> None:
    assert ratio(stock, ours) == expected


def test_one_thread_is_given_back() -> None:
    threads = cv2.getNumThreads()
    has_cores = hasattr(os, "sched_getaffinity")
    cores = os.sched_getaffinity(0) if has_cores else set()
    with one_thread():
        assert cv2.getNumThreads() == 1
        if has_cores:
            assert len(os.sched_getaffinity(0)) == 1
    assert cv2.getNumThreads() == threads
    if has_cores:
        assert os.sched_getaffinity(0) == cores
