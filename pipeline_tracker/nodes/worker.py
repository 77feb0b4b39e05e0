"""A thread that computes, so that messages are received meanwhile."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")

# What is being computed is waited for at most this long when a node ends, s.
END_WITHIN = 0.3


class Worker(Generic[Item]):
    """Does one thing after another in a thread of its own, oldest first.

    Why a thread of our own: rclpy's multi-threaded executor requeues busily, and with a
    single-threaded one alone no message is taken while a node computes; DDS would then drop images
    without a word, here each one is counted.
    """

    def __init__(
        self,
        work: Callable[[Item], None],
        depth: int,
        on_overrun: Callable[[Item], None],
        name: str,
    ) -> None:
        """Start the thread.

        Args:
            work: done with each item, in the thread; it must not raise.
            depth: items waiting at most.
            on_overrun: called with the oldest item, which gives way where one more comes.
            name: of the thread.
        """
        self._work = work
        self._depth = depth
        self._on_overrun = on_overrun
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._computes = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether something waits or is being done."""
        with self._changed:
            return self._computes or bool(self._items)

    def put(self, item: Item) -> None:
        """Give the thread one more thing to do."""
        with self._changed:
            self._items.append(item)
            surplus = self._items.popleft() if len(self._items) > self._depth else None
            self._changed.notify()
        if surplus is not None:
            self._on_overrun(surplus)

    def clear(self) -> list[Item]:
        """Forget what waits, and return it."""
        with self._changed:
            forgotten = list(self._items)
            self._items.clear()
        return forgotten

    def close(self, timeout: float) -> None:
        """End the thread after what it does now, and wait for that at most ``timeout`` seconds.

        What waits is not done any more; ``clear`` tells what that was.
        """
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items or self._ended)
                if self._ended:
                    return
                item = self._items.popleft()
                self._computes = True
            try:
                self._work(item)
            except Exception:
                # The node may have gone while its last item was computed.
                if not self._ended:
                    raise
            finally:
                self._computes = False
