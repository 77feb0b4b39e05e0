"""The echoes of the way behind, kept where they were heard (5.2).

The beam of a bottom echo sounder meets the pipe below the vehicle, the camera sees it further
ahead. The echoes of the last metres, carried along by the poses, tell height and slope of the pipe
up to here, and the slope leads on into the view.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.echoes import Echoes, PlacedEcho
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS

Array = NDArray[np.float64]

# The pipe does not go on straight for ever, and the poses drift.
_WAY = 4.0
_MOST = 400
# Places of the axis that are remembered, three of each frame.
_MOST_PLACES = 60
# What the poses add to an echo's standard deviation, m for each metre of way since.
_POSE_SIGMA = 0.01


class EchoTrail:
    """Echoes of the last metres of way."""

    def __init__(self, max_age: float) -> None:
        """Start without echoes.

        Args:
            max_age: an echo without a pose is used for a frame that much later at most, s.
        """
        self._max_age = round(max_age * SECOND_NS)
        self._placed: deque[tuple[PlacedEcho, Pose]] = deque(maxlen=_MOST)
        self._alone: PlacedEcho | None = None
        self._passed: deque[Array] = deque(maxlen=_MOST_PLACES)

    def add(self, echoes: Sequence[PlacedEcho]) -> None:
        """Take in what was heard since the last frame."""
        for placed in echoes:
            if placed.pose is not None:
                self._placed.append((placed, placed.pose))
            self._alone = placed

    def see(self, places: Array) -> None:
        """Remember where an image showed the axis of the pipe.

        Args:
            places: (P, 3), odom, m.
        """
        self._passed.extend(places)

    def clear(self) -> None:
        """Forget all."""
        self._placed.clear()
        self._passed.clear()
        self._alone = None

    def around(self, stamp_ns: int, pose: Pose | None) -> Echoes:
        """Return the echoes that are of use for a frame, in base_link at its stamp.

        Args:
            stamp_ns: the frame's stamp, ns.
            pose: odom <- base_link there; None: only the last echo is used, where it is fresh.
        """
        if pose is None:
            return self._last_one(stamp_ns)
        while self._placed and self._way(self._placed[0][1], pose) > _WAY:
            self._placed.popleft()
        if not self._placed:
            return Echoes.none()
        back = pose.inverse()
        changes = [back @ there for _, there in self._placed]
        heard = [placed.echo for placed, _ in self._placed]
        ways = np.array([self._way(there, pose) for _, there in self._placed])
        sigmas = np.array([echo.sigma for echo in heard])
        return Echoes(
            np.stack([c.apply(e.origin) for c, e in zip(changes, heard, strict=True)]),
            np.stack([c.rotate(e.direction) for c, e in zip(changes, heard, strict=True)]),
            np.array([echo.distance for echo in heard]),
            np.hypot(sigmas, _POSE_SIGMA * np.sqrt(ways)),
            np.array([echo.half_angle for echo in heard]),
            back.apply(np.array(self._passed)) if self._passed else np.zeros((0, 3)),
        )

    @staticmethod
    def _way(there: Pose, here: Pose) -> float:
        return float(np.linalg.norm(here.translation - there.translation))

    def _last_one(self, stamp_ns: int) -> Echoes:
        if self._alone is None or stamp_ns - self._alone.echo.stamp_ns > self._max_age:
            return Echoes.none()
        echo = self._alone.echo
        return Echoes(
            echo.origin[None],
            echo.direction[None],
            np.array([echo.distance]),
            np.array([echo.sigma]),
            np.array([echo.half_angle]),
        )
