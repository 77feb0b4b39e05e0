"""Frames read and decoded on a second core, while the first one computes."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterator
from functools import partial
from typing import Any, NamedTuple

from pipeline_tracker.echoes import Echo, EchoBuffer
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.replay.input import Frame

# Called with poses, forget and echoes, see ``ReplayInput.frames``.
Frames = Callable[[PoseBuffer, Callable[[], None], EchoBuffer], Iterator[Frame]]

# A thread that waits for room looks whether it is still wanted so often, s.
_LOOK = 0.1


class _Step(NamedTuple):
    """A frame, or None at the end, what came before it, and the error that reading ended with."""

    frame: Frame | None
    before: list[Callable[[], Any]]
    error: Exception | None = None


def read_ahead(
    frames: Frames, poses: PoseBuffer, forget: Callable[[], None], echoes: EchoBuffer
) -> Generator[Frame, None, None]:
    """Yield the same frames, with the same poses and echoes at each, two frames ahead at most.

    The input fills buffers of its own; what came before a frame is put into those given when the
    frame is yielded. To be closed.

    Args:
        frames: the input.
        poses, forget, echoes: see ``ReplayInput.frames``.

    Raises:
        Exception: whatever reading raised, after the frames before.
    """
    steps: queue.Queue[_Step] = queue.Queue(1)
    unwanted = threading.Event()
    reader = threading.Thread(
        target=_read, args=(frames, poses, forget, echoes, steps, unwanted), daemon=True
    )
    reader.start()
    try:
        while True:
            step = steps.get()
            for take in step.before:
                take()
            if step.error is not None:
                raise step.error
            if step.frame is None:
                return
            yield step.frame
    finally:
        unwanted.set()
        reader.join()


def _read(
    frames: Frames,
    poses: PoseBuffer,
    forget: Callable[[], None],
    echoes: EchoBuffer,
    steps: queue.Queue[_Step],
    unwanted: threading.Event,
) -> None:
    notes: list[Callable[[], Any]] = []
    own_poses, own_echoes = _NotedPoses(poses, notes), _NotedEchoes(echoes, notes)

    def forgotten() -> None:
        own_poses.clear()
        own_echoes.clear()
        notes.append(forget)

    error = None
    try:
        for frame in frames(own_poses, forgotten, own_echoes):
            if not _put(_Step(frame, notes.copy()), steps, unwanted):
                return
            notes.clear()
    except Exception as raised:  # noqa: BLE001 - raised again where the frames are taken
        error = raised
    _put(_Step(None, notes, error), steps, unwanted)


def _put(step: _Step, steps: queue.Queue[_Step], unwanted: threading.Event) -> bool:
    """Wait for room; return whether there was some before the rest was unwanted."""
    while not unwanted.is_set():
        try:
            steps.put(step, timeout=_LOOK)
        except queue.Full:
            continue
        return True
    return False


class _NotedPoses(PoseBuffer):
    """Poses, and a note of each that is to be added to others."""

    def __init__(self, others: PoseBuffer, notes: list[Callable[[], Any]]) -> None:
        super().__init__(0.0)
        self._others, self._notes = others, notes

    def add(self, stamp_ns: int, pose: Pose) -> bool:
        self._notes.append(partial(self._others.add, stamp_ns, pose))
        return super().add(stamp_ns, pose)


class _NotedEchoes(EchoBuffer):
    """Echoes, and a note of each that is to be added to others."""

    def __init__(self, others: EchoBuffer, notes: list[Callable[[], Any]]) -> None:
        super().__init__()
        self._others, self._notes = others, notes

    def add(self, stamp_ns: int, echo: Echo | None) -> bool:
        self._notes.append(partial(self._others.add, stamp_ns, echo))
        return super().add(stamp_ns, echo)
