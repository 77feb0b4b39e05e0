"""Left and right images put together by their stamps, in bounded memory."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")

PAIRED = "paired"
NO_RIGHT = "no_right_image"
NO_LEFT = "no_left_image"
LATE = "late"
REPEATED = "repeated"
QUEUE_FULL = "queue_full"

_LONG_AGO = -(2**63)


@dataclass(frozen=True)
class Stamped(Generic[Item]):
    """Something with a stamp in ns."""

    stamp_ns: int
    item: Item


@dataclass(frozen=True)
class Matched(Generic[Item]):
    """What became of an image.

    Attributes:
        left: the left image; None where a right image found none.
        right: the right image; None where a left image found none.
        reason: empty for a pair, else why there is none.
    """

    left: Stamped[Item] | None
    right: Stamped[Item] | None
    reason: str = ""


class StereoSynchroniser(Generic[Item]):
    """Pairs left and right images whose stamps agree within a tolerance.

    Each image comes out exactly once: in a pair, or alone with a reason (``counts``). Outcomes of
    left images come in the order of their stamps. A left image takes the right image nearest in
    time, unless that one lies nearer to another left image. A pair is settled as soon as no nearer
    image can come: at once where the stamps are equal, or where each camera's images have so far
    been much further apart than the tolerance; else with the next image. So what is paired does
    not depend on which image came first.

    No clock is read: time is that of the stamps.
    """

    def __init__(self, tolerance: float, max_wait: float, queue: int) -> None:
        """Make an empty synchroniser.

        Args:
            tolerance: largest difference of the stamps of a pair, s.
            max_wait: an image is given up once the newest stamp of either camera is later than its
                own by more than this, s.
            queue: images held at most for each camera; the oldest gives way.
        """
        self._tolerance = round(tolerance * 1e9)
        self._max_wait = max(round(max_wait * 1e9), self._tolerance)
        self._queue = queue
        self.counts: Counter[str] = Counter()
        self._left: _Camera[Item] = _Camera()
        self._right: _Camera[Item] = _Camera()

    def __len__(self) -> int:
        """Return the number of images held."""
        return len(self._left.held) + len(self._right.held)

    def add_left(self, stamp_ns: int, item: Item) -> list[Matched[Item]]:
        """Take in a left image and return what is settled by it."""
        return self._add(self._left, Stamped(stamp_ns, item))

    def add_right(self, stamp_ns: int, item: Item) -> list[Matched[Item]]:
        """Take in a right image and return what is settled by it."""
        return self._add(self._right, Stamped(stamp_ns, item))

    def flush(self) -> list[Matched[Item]]:
        """Settle all that is held: no image will come any more."""
        return self._settle(final=True)

    def reset(self) -> list[Matched[Item]]:
        """Settle all that is held and forget the stamps: the clock went back."""
        settled = self.flush()
        self._left, self._right = _Camera(), _Camera()
        return settled

    def _add(self, camera: _Camera[Item], image: Stamped[Item]) -> list[Matched[Item]]:
        refused = camera.add(image)
        if refused:
            return [self._alone(camera, image, refused)]
        settled = self._settle(final=False)
        while len(camera.held) > self._queue:
            settled.append(self._give_up(camera, QUEUE_FULL))
        return settled

    def _settle(self, *, final: bool) -> list[Matched[Item]]:
        out: list[Matched[Item]] = []
        while self._left.held:
            left = self._left.held[0]
            right = self._partner(left)
            if not (final or self._overdue(left) or self._is_settled(left, right)):
                break
            if right is None:
                out.append(self._give_up(self._left, NO_RIGHT))
                continue
            # Pairs don't cross: what the right camera took before is not wanted any more.
            while self._right.held[0] is not right:
                out.append(self._give_up(self._right, NO_LEFT))
            self.counts[PAIRED] += 1
            out.append(Matched(self._left.take(), self._right.take()))
        while self._right.held:
            right = self._right.held[0]
            wanted = any(self._gap(left, right) <= self._tolerance for left in self._left.held)
            passed = self._left.newest > right.stamp_ns + self._tolerance
            if not final and (wanted or not (passed or self._overdue(right))):
                break
            out.append(self._give_up(self._right, NO_LEFT))
        return out

    def _partner(self, left: Stamped[Item]) -> Stamped[Item] | None:
        """Return the nearest right image in reach that no other left one is nearer to."""
        near = [r for r in self._right.held if self._gap(left, r) <= self._tolerance]
        for right in sorted(near, key=lambda r: self._gap(left, r)):
            others = (o for o in self._left.held if o is not left)
            if all(self._gap(left, right) <= self._gap(other, right) for other in others):
                return right
        return None

    def _is_settled(self, left: Stamped[Item], right: Stamped[Item] | None) -> bool:
        if right is None:
            return self._right.newest > left.stamp_ns + self._tolerance
        gap = self._gap(left, right)
        return self._right.next >= left.stamp_ns + gap and self._left.next >= right.stamp_ns + gap

    def _overdue(self, image: Stamped[Item]) -> bool:
        newest = max(self._left.newest, self._right.newest)
        return newest - image.stamp_ns > self._max_wait

    def _give_up(self, camera: _Camera[Item], reason: str) -> Matched[Item]:
        image = camera.take()
        partner = self._right if camera is self._left else self._left
        if abs(partner.given_up - image.stamp_ns) <= self._tolerance:
            reason = LATE
        camera.given_up = image.stamp_ns
        return self._alone(camera, image, reason)

    def _alone(self, camera: _Camera[Item], image: Stamped[Item], reason: str) -> Matched[Item]:
        self.counts[reason] += 1
        if camera is self._left:
            return Matched(image, None, reason)
        return Matched(None, image, reason)

    @staticmethod
    def _gap(one: Stamped[Item], other: Stamped[Item]) -> int:
        return abs(one.stamp_ns - other.stamp_ns)


class _Camera(Generic[Item]):
    """The images of one camera that wait, in the order of their stamps."""

    def __init__(self) -> None:
        self.held: list[Stamped[Item]] = []
        self.newest = _LONG_AGO
        self.given_up = _LONG_AGO
        self._settled = _LONG_AGO
        self._period = 0

    @property
    def next(self) -> int:
        """The least stamp that the next image may have, by the images so far, ns."""
        # Half of the shortest time between two images leaves room for jitter.
        return self.newest + max(1, self._period // 2)

    def add(self, image: Stamped[Item]) -> str:
        """Take in an image; return why not, or nothing."""
        stamp = image.stamp_ns
        index = bisect_left([held.stamp_ns for held in self.held], stamp)
        held = index < len(self.held) and self.held[index].stamp_ns == stamp
        if held or stamp == self._settled:
            return REPEATED
        if stamp < self._settled:
            return LATE
        self.held.insert(index, image)
        if self.newest != _LONG_AGO:
            period = abs(stamp - self.newest)
            self._period = min(self._period or period, period)
        self.newest = max(self.newest, stamp)
        return ""

    def take(self) -> Stamped[Item]:
        """Take out the oldest image."""
        image = self.held.pop(0)
        self._settled = image.stamp_ns
        return image
