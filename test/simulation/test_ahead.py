from __future__ import annotations

import threading
import time

import pytest

from pipeline_tracker.simulation.ahead import made_ahead


def test_all_comes_in_order_however_long_each_takes() -> None:
    def make(job: int) -> int:
        time.sleep(0.02 if job % 2 == 0 else 0.0)
        return job * job

    assert list(made_ahead(make, range(7), 3)) == [0, 1, 4, 9, 16, 25, 36]
    assert list(made_ahead(make, [], 2)) == []


def test_others_are_made_while_one_is_waited_for() -> None:
    together = threading.Barrier(2, timeout=5)

    def make(job: int) -> int:
        # Each needs another one in the making at the same time.
        together.wait()
        return job

    assert list(made_ahead(make, range(4), 2)) == [0, 1, 2, 3]


def test_no_more_are_made_than_wait_or_were_taken() -> None:
    begun: list[int] = []

    def make(job: int) -> int:
        begun.append(job)
        return job

    made = made_ahead(make, range(100), 2)
    assert [next(made), next(made)] == [0, 1]
    time.sleep(0.05)
    assert max(begun) <= 3
    made.close()
    assert max(begun) <= 3


def test_an_error_comes_where_its_job_is_and_ends_the_making() -> None:
    begun: list[int] = []

    def make(job: int) -> int:
        begun.append(job)
        if job == 2:
            raise ValueError("job 2")
        return job

    made = made_ahead(make, range(100), 2)
    assert [next(made), next(made)] == [0, 1]
    with pytest.raises(ValueError, match="job 2"):
        next(made)
    assert max(begun) < 5
