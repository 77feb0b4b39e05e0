"""Unpacking the chunks of an mcap file, in bounded memory."""

from __future__ import annotations

from io import BytesIO
from typing import IO
from zlib import crc32

import lz4.frame
import zstandard
from mcap.records import Chunk

from pipeline_tracker.errors import BagError

# The largest chunk, and message, that is taken: some hundred times what recorders write.
LARGEST = 256 * 2**20
COMPRESSIONS = ("", "lz4", "zstd")
_PIECE = 2**16


def unpack_chunk(chunk: Chunk, *, cut: bool = False) -> bytes:
    """Return the records of a chunk as bytes.

    Where nothing can be checked, because the chunk is cut off or has no checksum, the bytes before
    the first that cannot be unpacked are returned.

    Args:
        chunk: as it came from the file.
        cut: the chunk breaks off.

    Raises:
        BagError: it is larger than ``LARGEST``, of another compression, or its checksum does not
            fit.
    """
    if chunk.uncompressed_size > LARGEST:
        raise BagError(f"a chunk of {chunk.uncompressed_size} bytes, expected at most {LARGEST}")
    data = _unpacked(chunk)
    known = not cut or len(data) == chunk.uncompressed_size
    if chunk.uncompressed_crc and known and crc32(data) != chunk.uncompressed_crc:
        raise BagError("the checksum of a chunk does not fit")
    return data


def _unpacked(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    packed = BytesIO(chunk.data)
    if chunk.compression == "":
        return packed.read(size)
    # Read as a stream: what claims to be small cannot grow beyond its size.
    stream: IO[bytes]
    if chunk.compression == "lz4":
        stream = lz4.frame.open(packed)
    elif chunk.compression == "zstd":
        stream = zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(packed)
    else:
        raise BagError(f"a chunk compressed by {chunk.compression[:20]!r}, expected lz4 or zstd")
    unpacked = bytearray()
    while len(unpacked) < size:
        try:
            piece = stream.read(min(_PIECE, size - len(unpacked)))
        except (zstandard.ZstdError, RuntimeError, EOFError):
            break
        if not piece:
            break
        unpacked += piece
    return bytes(unpacked)
