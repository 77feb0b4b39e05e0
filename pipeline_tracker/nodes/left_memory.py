"""Shared memory that killed processes have left: Fast DDS does not take it back by itself.

Each participant has a segment (32 MiB by ``config/fastdds.xml``), and beside it a file that it
locks while it lives. A process that is killed leaves both; a node that is killed and started again
for long enough would fill the machine's memory.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where Fast DDS has its segments

# The names of segments' locks, and how old they must be, s: one that has just been made may not be
# locked yet.
_LOCKS = "fastrtps_????????????????_el"
_SETTLED = 10.0


def left_segments(place: Path = SHARED_MEMORY) -> list[Path]:
    """Return the segments whose processes are gone.

    Args:
        place: their directory.
    """
    if sys.platform != "linux":
        return []
    return [lock.with_name(lock.name[:-3]) for lock in place.glob(_LOCKS) if _free(lock)]


def remove_left_segments(place: Path = SHARED_MEMORY) -> int:
    """Remove the segments whose processes are gone, where this user may.

    Args:
        place: their directory.

    Returns:
        How many were removed.
    """
    removed = 0
    for segment in left_segments(place):
        with suppress(OSError):
            segment.unlink(missing_ok=True)
            segment.with_name(f"{segment.name}_el").unlink(missing_ok=True)
            removed += 1
    return removed


def _free(lock: Path) -> bool:
    """Whether nobody holds a lock."""
    # Linux has it, others not.
    import fcntl  # noqa: PLC0415

    try:
        with lock.open("r+b") as file:
            if time.time() - os.fstat(file.fileno()).st_mtime < _SETTLED:
                return False
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        # Held, gone meanwhile, or another user's.
        return False
    return True
