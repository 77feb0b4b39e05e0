from __future__ import annotations

import threading

import pytest

from pipeline_tracker.simulation.ahead import made_ahead


def test_all_comes_in_order_however_long_each_takes() -> None:
    done = [threading.Event() for _ in range(8)]
    # There is no job 7 for job 6 to wait for.
    done[7].set()

    def make(job: int) -> int:
        # Those of even number end after the next one.
        assert job % 2 or done[job + 1].wait(5.0)
        done[job].set()
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
    too_early = threading.Event()

    def make(job: int) -> int:
        begun.append(job)
        if job > 3:
            too_early.set()
        return job

    made = made_ahead(make, range(100), 2)
    assert [next(made), next(made)] == [0, 1]
    assert not too_early.wait(0.05)
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
