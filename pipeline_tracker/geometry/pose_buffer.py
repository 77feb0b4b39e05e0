"""Poses of the last seconds, and the pose at a stamp between them."""

from __future__ import annotations

from bisect import bisect_left

from pipeline_tracker.geometry.pose import Pose, interpolate

SECOND_NS = 1_000_000_000


class PoseBuffer:
    """Poses in the order of their stamps, the last ``keep`` seconds of them.

    A pose at a stamp is one that came with this very stamp, or is interpolated between its two
    neighbours where these are at most ``max_gap`` apart; it is never extrapolated. Not safe for use
    by several threads at once.
    """

    def __init__(self, max_gap: float, keep: float = 30.0) -> None:
        """Make an empty buffer.

        Args:
            max_gap: longest time between two poses to interpolate over, s, at least 0.
            keep: time before the newest pose that is remembered, s, above 0.

        Raises:
            ValueError: a time is negative or not a number.
        """
        if not max_gap >= 0.0 or not keep > 0.0:
            raise ValueError(f"max_gap={max_gap} and keep={keep}: expected at least 0 and above 0")
        self._max_gap = round(max_gap * SECOND_NS)
        self._keep = round(keep * SECOND_NS)
        self._stamps: list[int] = []
        self._poses: list[Pose] = []

    def __len__(self) -> int:
        """Return the number of poses held."""
        return len(self._stamps)

    def add(self, stamp_ns: int, pose: Pose) -> bool:
        """Take in a pose.

        Args:
            stamp_ns: its stamp, ns.
            pose: pose of base_link in odom.

        Returns:
            Whether it was taken; False where its stamp is not after the newest one (repeated or out
            of order): such a pose is dropped.
        """
        if self._stamps and stamp_ns <= self._stamps[-1]:
            return False
        self._stamps.append(stamp_ns)
        self._poses.append(pose)
        forgotten = bisect_left(self._stamps, stamp_ns - self._keep)
        if forgotten:
            del self._stamps[:forgotten], self._poses[:forgotten]
        return True

    def at(self, stamp_ns: int) -> Pose | None:
        """Return the pose at a stamp, or None where it is not known.

        Args:
            stamp_ns: stamp, ns.

        Returns:
            The pose with this stamp as it came, else one interpolated between two poses at most
            ``max_gap`` apart (position linearly, rotation along the shortest arc).
        """
        index = bisect_left(self._stamps, stamp_ns)
        if index == len(self._stamps):
            return None
        after = self._stamps[index]
        if after == stamp_ns:
            return self._poses[index]
        if index == 0:
            return None
        before = self._stamps[index - 1]
        if after - before > self._max_gap:
            return None
        fraction = (stamp_ns - before) / (after - before)
        return interpolate(self._poses[index - 1], self._poses[index], fraction)

    def settled(self, stamp_ns: int) -> bool:
        """Return whether waiting longer can bring nothing new about this stamp.

        True when a pose with this stamp or a later one has arrived.
        """
        return bool(self._stamps) and self._stamps[-1] >= stamp_ns

    def clear(self) -> None:
        """Forget all poses."""
        self._stamps.clear()
        self._poses.clear()
