"""The echo sounder: what its beam met, by stamp, until a frame asks for it (5.2)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer

Array = NDArray[np.float64]

# Echoes that wait for a frame: a sounder of 100 Hz between frames 10 s apart.
_MOST = 1000


@dataclass(frozen=True)
class Echo:
    """The first echo of a ping.

    Attributes:
        stamp_ns: its stamp, ns.
        origin: where the beam begins, base_link, (3,), m.
        direction: unit direction of the beam's middle, base_link, (3,).
        distance: way to what the beam met first, m.
        sigma: its standard deviation, m.
        half_angle: half the beam's width, rad.
    """

    stamp_ns: int
    origin: Array
    direction: Array
    distance: float
    sigma: float
    half_angle: float


@dataclass(frozen=True)
class PlacedEcho:
    """An echo with the vehicle's pose at its stamp.

    Attributes:
        echo: the echo.
        pose: odom <- base_link; None where it is not known.
    """

    echo: Echo
    pose: Pose | None


class EchoBuffer:
    """Echoes in the order of their stamps, handed out once, to the first frame after them."""

    def __init__(self) -> None:
        """Make an empty buffer."""
        self._echoes: deque[Echo] = deque(maxlen=_MOST)
        self._newest: int | None = None

    def add(self, stamp_ns: int, echo: Echo | None) -> bool:
        """Take in a ping.

        Args:
            stamp_ns: its stamp, ns.
            echo: what came back; None where nothing did, or nothing that can be used.

        Returns:
            Whether it was taken; False where its stamp is not after the newest one.
        """
        if self._newest is not None and stamp_ns <= self._newest:
            return False
        self._newest = stamp_ns
        if echo is not None:
            self._echoes.append(echo)
        return True

    def take(self, stamp_ns: int, poses: PoseBuffer) -> list[PlacedEcho]:
        """Hand out the echoes up to a stamp that no frame before has got.

        Args:
            stamp_ns: stamp of the frame, ns.
            poses: the vehicle's poses.
        """
        taken = []
        while self._echoes and self._echoes[0].stamp_ns <= stamp_ns:
            echo = self._echoes.popleft()
            taken.append(PlacedEcho(echo, poses.at(echo.stamp_ns)))
        return taken

    def settled(self, stamp_ns: int) -> bool:
        """Return whether a ping of this stamp or a later one has come."""
        return self._newest is not None and self._newest >= stamp_ns

    def silent_for(self, stamp_ns: int, seconds: float) -> bool:
        """Return whether no ping is known of the time before a stamp: none is worth waiting for."""
        return self._newest is None or stamp_ns - self._newest > seconds * SECOND_NS

    def clear(self) -> None:
        """Forget all."""
        self._echoes.clear()
        self._newest = None


@dataclass(frozen=True)
class Echoes:
    """Echoes of the last stretch of way, all in one frame of coordinates.

    Attributes:
        origins: (N, 3), m.
        directions: (N, 3), unit.
        distances: (N,), m.
        sigmas: standard deviations of the distances, poses included, (N,), m.
        half_angles: (N,), rad.
        passed: places of the axis that images showed before, (P, 3), m: they tell how far to the
            side of it a beam went down.
    """

    origins: Array
    directions: Array
    distances: Array
    sigmas: Array
    half_angles: Array
    passed: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def none(cls) -> Echoes:
        """Return no echoes."""
        nothing = np.zeros(0)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), nothing, nothing, nothing)

    def __len__(self) -> int:
        """Return the number of echoes."""
        return len(self.distances)

    def seen_from(self, change: Pose) -> Echoes:
        """Return the same in other coordinates; ``change`` is new frame <- this frame."""
        if not len(self):
            return self
        return replace(
            self,
            origins=change.apply(self.origins),
            directions=change.rotate(self.directions),
            passed=change.apply(self.passed) if len(self.passed) else self.passed,
        )
