"""Frames that are read on a second core: the same ones, with the same poses at each."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing

import numpy as np
import pytest

from pipeline_tracker.echoes import Echo, EchoBuffer
from pipeline_tracker.errors import BagError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.replay.ahead import read_ahead
from pipeline_tracker.replay.input import Frame

SECOND = 1_000_000_000
Known = tuple[int, int, int, bool, bool]


def heard(stamp_ns: int) -> Echo:
    return Echo(stamp_ns, np.zeros(3), np.array([0.0, 0.0, -1.0]), 2.0, 0.1, 0.1)


def recorded(
    poses: PoseBuffer, forget: Callable[[], None], echoes: EchoBuffer
) -> Generator[Frame, None, None]:
    """Twenty frames, each after its pose and ping; the clock is set back before the twelfth."""
    for k in range(20):
        if k == 12:
            forget()
        stamp = (k if k < 12 else k - 12) * SECOND
        assert poses.add(stamp, Pose.identity())
        assert not poses.add(stamp, Pose.identity())
        assert echoes.add(stamp, None if k % 2 else heard(stamp))
        assert poses.settled(stamp)
        assert echoes.settled(stamp)
        yield Frame(stamp)


def seen(
    read: Callable[[PoseBuffer, Callable[[], None], EchoBuffer], Iterator[Frame]],
) -> list[Known]:
    """What is known at each frame."""
    poses, echoes = PoseBuffer(1.0), EchoBuffer()

    def forget() -> None:
        poses.clear()
        echoes.clear()

    known = []
    for frame in read(poses, forget, echoes):
        stamp = frame.stamp_ns
        echo_count = len(echoes.take(stamp, poses))
        later = poses.settled(stamp + 1) or echoes.settled(stamp + 1)
        known.append((stamp, len(poses), echo_count, poses.at(stamp) is not None, later))
    return known


def test_each_frame_comes_with_what_came_before_it_and_nothing_else() -> None:
    expected = seen(recorded)
    assert len(expected) == 20
    assert seen(lambda *buffers: read_ahead(recorded, *buffers)) == expected


def test_an_error_comes_after_the_frames_before_it() -> None:
    def breaks_off(*_buffers: object) -> Generator[Frame, None, None]:
        yield Frame(1)
        yield Frame(2)
        raise BagError("damaged")

    frames = read_ahead(breaks_off, PoseBuffer(1.0), lambda: None, EchoBuffer())
    assert [next(frames).stamp_ns for _ in range(2)] == [1, 2]
    with pytest.raises(BagError, match="damaged"):
        next(frames)


def test_it_reads_two_frames_ahead_at_most_and_ends_when_it_is_closed() -> None:
    begun = 0
    ended = threading.Event()

    def many(*_buffers: object) -> Generator[Frame, None, None]:
        nonlocal begun
        try:
            for k in range(1000):
                begun += 1
                yield Frame(k)
        finally:
            ended.set()

    before = threading.active_count()
    with closing(read_ahead(many, PoseBuffer(1.0), lambda: None, EchoBuffer())) as frames:
        for k in range(5):
            assert next(frames).stamp_ns == k
    assert threading.active_count() == before
    assert begun <= 7
    assert ended.wait(1.0)
