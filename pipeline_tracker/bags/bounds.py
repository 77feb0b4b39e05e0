"""Bounds on the memory that a bag can make the reader take.

The library that reads bags unpacks a chunk to whatever size its data grow to. Here it is given
functions that stop at the size that the chunk's head says, and chunks that would all be held at
once, because their times overlap, are counted before they are read.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from functools import partial
from typing import Any

from mcap.records import Chunk
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import storage_mcap

from pipeline_tracker.bags.chunks import LARGEST, unpack_chunk
from pipeline_tracker.errors import BagError

# Of all chunks whose times overlap, bytes.
LARGEST_AT_ONCE = 4 * LARGEST


def bound_unpacking() -> None:
    """Let the library unpack chunks within their sizes."""
    for compression in ("lz4", "zstd"):
        storage_mcap.DECOMPRESSORS[compression] = partial(_unpack, compression)


def check_chunks(reader: AnyReader) -> None:
    """Check that the chunks of an open bag can be held.

    Raises:
        BagError: one is larger than ``LARGEST``, or those that overlap are too large together.
    """
    for bag in reader.readers:
        whole = getattr(bag, "storage", None)
        # One file, or those of a directory; a database has no chunks.
        for storage in getattr(whole, "storages", [whole]):
            _check(getattr(storage, "chunks", ()))


def _check(chunks: Iterable[Any]) -> None:
    held: list[tuple[int, int]] = []
    total = 0
    for chunk in sorted(chunks, key=lambda item: int(item.message_start_time)):
        size = int(chunk.uncompressed_size)
        if size > LARGEST:
            raise BagError(f"a chunk of {size} bytes, expected at most {LARGEST}")
        while held and held[0][0] < chunk.message_start_time:
            total -= heapq.heappop(held)[1]
        heapq.heappush(held, (int(chunk.message_end_time), size))
        total += size
        if total > LARGEST_AT_ONCE:
            raise BagError(
                f"chunks of {total} bytes overlap in time, expected at most {LARGEST_AT_ONCE}"
            )


def _unpack(compression: str, data: bytes, size: int) -> bytes:
    return unpack_chunk(Chunk(compression, data, 0, 0, 0, size))
