"""Bounds on the memory, and room on the disk, that a bag can make the reader take.

The library that reads bags unpacks a chunk, a message or a file to whatever size its data grow to.
Here it is given functions that stop: at the size that the chunk's head says, and where no head says
any, at a size beyond all that is recorded. Chunks that would all be held at once, because their
times overlap, are counted before they are read.
"""

from __future__ import annotations

import heapq
import os
from bz2 import BZ2Decompressor
from collections.abc import Iterable
from functools import partial
from typing import IO, Any

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.records import Chunk
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap
from typing_extensions import Self

from pipeline_tracker.bags.chunks import LARGEST, unpack_chunk
from pipeline_tracker.errors import BagError

# Of all chunks whose times overlap, bytes.
LARGEST_AT_ONCE = 4 * LARGEST
# A file unpacks to no more than so many times its size, and one chunk more.
_LARGEST_RATIO = 100
_LARGEST_WINDOW = LARGEST


def bound_unpacking() -> None:
    """Let the library unpack chunks, messages and files within bounds."""
    for compression in ("lz4", "zstd"):
        storage_mcap.DECOMPRESSORS[compression] = partial(_unpack, compression)
    rosbag1_reader.decompressors["bz2"] = lambda data: _whole(BZ2Decompressor(), data)
    rosbag1_reader.decompressors["lz4"] = lambda data: _whole(LZ4FrameDecompressor(), data)
    # What it calls for bags whose files or messages are packed.
    rosbag2_reader.zstd = _Zstd  # type: ignore[assignment,attr-defined]


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


def _whole(decompressor: Any, data: bytes) -> bytes:
    unpacked = bytes(decompressor.decompress(data, max_length=LARGEST + 1))
    if len(unpacked) > LARGEST:
        raise BagError(f"a chunk of more than {LARGEST} bytes")
    return unpacked


class _Zstd:
    """Stands in for the module that unpacks messages and files."""

    @staticmethod
    def decompress(data: bytes) -> bytes:
        """Return a message; one that breaks off does not fit its type, and is counted as such."""
        unpacked = unpack_chunk(Chunk("zstd", data, 0, 0, 0, LARGEST))
        if len(unpacked) == LARGEST:
            raise BagError(f"a message of {LARGEST} bytes or more")
        return unpacked

    @staticmethod
    def open(stream: IO[bytes], _mode: str) -> _UnpackedFile:
        """Open a packed file."""
        return _UnpackedFile(stream)


class _UnpackedFile:
    """Reads a packed file, to a bound; a context manager."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._left = LARGEST + _LARGEST_RATIO * os.fstat(stream.fileno()).st_size
        decompressor = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
        self._unpacked = decompressor.stream_reader(stream, read_across_frames=True, closefd=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._unpacked.close()  # type: ignore[no-untyped-call]

    def read(self, size: int) -> bytes:
        """Return the next bytes; none at the end.

        Raises:
            BagError: there are more than a bag has.
        """
        piece = self._unpacked.read(size)
        self._left -= len(piece)
        if self._left < 0:
            raise BagError(f"a file that unpacks to more than {_LARGEST_RATIO} times its size")
        return piece
