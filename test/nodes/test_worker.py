"""The thread that computes."""

from __future__ import annotations

import threading

from pipeline_tracker.nodes.worker import Worker

WITHIN = 30.0


def test_things_are_done_in_order_in_another_thread() -> None:
    done: list[tuple[int, str]] = []
    finished = threading.Event()

    def work(item: int) -> None:
        done.append((item, threading.current_thread().name))
        if item == 4:
            finished.set()

    worker = Worker(work, 5, lambda _: None, "test-worker")
    for item in range(5):
        worker.put(item)
    assert finished.wait(WITHIN)
    worker.close(WITHIN)
    assert done == [(item, "test-worker") for item in range(5)]


def test_the_oldest_gives_way_and_is_told() -> None:
    started, go_on = threading.Event(), threading.Event()
    done: list[int] = []
    lost: list[int] = []

    def work(item: int) -> None:
        started.set()
        assert go_on.wait(WITHIN)
        done.append(item)

    worker = Worker(work, 2, lost.append, "test-worker")
    worker.put(0)
    assert started.wait(WITHIN)
    for item in (1, 2, 3, 4):
        worker.put(item)
    assert lost == [1, 2]
    assert worker.clear() == [3, 4]
    go_on.set()
    worker.put(5)
    while len(done) < 2:
        assert worker._thread.is_alive()
        worker._thread.join(0.01)
    worker.close(WITHIN)
    assert done == [0, 5]
    assert not worker._thread.is_alive()


def test_closing_waits_no_longer_than_told() -> None:
    started, go_on = threading.Event(), threading.Event()

    def work(_: int) -> None:
        started.set()
        go_on.wait(WITHIN)
        raise RuntimeError("the node has gone meanwhile, which is nobody's concern any more")

    worker = Worker(work, 1, lambda _: None, "test-worker")
    worker.put(0)
    assert started.wait(WITHIN)
    worker.close(0.0)
    assert worker._thread.is_alive()
    go_on.set()
    worker._thread.join(WITHIN)
    assert not worker._thread.is_alive()
