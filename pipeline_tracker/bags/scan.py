"""The records of an mcap file, whatever of them is still there.

The file is read from its beginning, without its index. Where a record cannot be what it says, the
next place that looks like one is searched, byte by byte; what is held at a time is one chunk.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, MessageIndex, Schema, Statistics

from pipeline_tracker.bags.chunks import COMPRESSIONS, LARGEST, unpack_chunk
from pipeline_tracker.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = 9
_WINDOW = 2**20
# What the content of a chunk is led by: times, size, checksum, and the names of compressions.
_CHUNK_HEAD = struct.Struct("<QQQII")
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.STATISTICS: Statistics,
}
_OPCODES = frozenset(int(code) for code in Opcode)
_FIXED = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}
# An opcode that is searched for, and a length below LARGEST.
_CANDIDATE = re.compile(rb"[\x02-\x07\x0f].{3}[\x00-\x10]\x00{4}", re.DOTALL)
_BROKEN = (McapError, struct.error, UnicodeDecodeError, ValueError)


class RecordScan:
    """Reads the records of one file, in the order in which they stand.

    Attributes:
        broken: how many places were no records, or records that cannot be read.
        refused: why chunks were left out, each reason once.
    """

    def __init__(self, stream: IO[bytes], size: int) -> None:
        """Read from a stream that can be sought.

        Args:
            stream: at any place.
            size: its bytes.
        """
        self._stream = stream
        self._size = size
        self._inside = False
        self.broken = 0
        self.refused: list[str] = []

    def records(self) -> Iterator[McapRecord]:
        """Yield schemas, channels, messages, message indexes and statistics."""
        place = 0
        while place < self._size:
            if self._read(place, len(MAGIC)) == MAGIC:
                # At both ends; in the middle too where files were joined.
                place += len(MAGIC)
                continue
            opcode, end = self._head(place)
            fits = end <= self._size and opcode in _OPCODES
            chunk = opcode == Opcode.CHUNK and not self._inside
            if fits and not chunk:
                yield from self._plain(opcode, place, end)
                if self._leads_on(end):
                    place = end
                    continue
            elif fits and self._is_chunk(place, end):
                yield from self._chunk(place, end, cut=False)
                place = end
                continue
            if end == self._size and fits:
                return
            # The length of this record is wrong, or the head of the next one is.
            self.broken += 1
            following = self._search(place + 1)
            if chunk:
                yield from self._chunk(place, following, cut=True)
            place = following

    def _plain(self, opcode: int, place: int, end: int) -> Iterator[McapRecord]:
        if opcode != Opcode.MESSAGE and opcode not in _KINDS:
            return
        record = self._parse(opcode, place, end)
        if record is not None:
            yield record

    def _parse(self, opcode: int, place: int, end: int) -> McapRecord | None:
        length = end - place - _HEAD
        if length > LARGEST:
            self.broken += 1
            return None
        body = ReadDataStream(BytesIO(self._read(place + _HEAD, length)))
        try:
            if opcode == Opcode.MESSAGE:
                record: McapRecord = Message.read(body, length)
                return record
            record = _KINDS[opcode].read(body)
        except _BROKEN:
            self.broken += 1
            return None
        return record

    def _chunk(self, place: int, end: int, *, cut: bool) -> Iterator[McapRecord]:
        head = self._chunk_head(place)
        if head is None:
            return
        start_time, end_time, size, crc, compression, first = head
        if cut and compression == "":
            # Its records are found one by one.
            return
        length = min(end - first, LARGEST)
        chunk = Chunk(
            compression=compression,
            data=self._read(first, length),
            message_end_time=end_time,
            message_start_time=start_time,
            uncompressed_crc=crc,
            uncompressed_size=size,
        )
        try:
            data = unpack_chunk(chunk, cut=cut)
        except BagError as error:
            self._refuse(str(error))
            return
        self.broken += len(data) < size and not cut
        inner = RecordScan(BytesIO(data), len(data))
        inner._inside = True
        yield from inner.records()
        self.broken += inner.broken

    def _refuse(self, reason: str) -> None:
        self.broken += 1
        if reason not in self.refused and len(self.refused) < 8:
            self.refused.append(reason)

    def _chunk_head(self, place: int) -> tuple[int, int, int, int, str, int] | None:
        """Return times, size, checksum, compression and where the packed data begins."""
        raw = self._read(place + _HEAD, _CHUNK_HEAD.size)
        if len(raw) < _CHUNK_HEAD.size:
            return None
        start, end, size, crc, length = _CHUNK_HEAD.unpack(raw)
        name_at = place + _HEAD + _CHUNK_HEAD.size
        name = self._read(name_at, min(length, 5)).decode("latin-1")
        if name not in COMPRESSIONS or length != len(name) or start > end:
            return None
        return start, end, size, crc, name, name_at + length + 8

    def _is_chunk(self, place: int, end: int) -> bool:
        head = self._chunk_head(place)
        if head is None:
            return False
        raw = self._read(head[5] - 8, 8)
        return len(raw) == 8 and head[5] + int.from_bytes(raw, "little") == end

    def _head(self, place: int) -> tuple[int, int]:
        """Return opcode and end of the record at a place; an end beyond the file's if it is cut."""
        raw = self._read(place, _HEAD)
        if len(raw) < _HEAD:
            return 0, self._size + 1
        return raw[0], place + _HEAD + int.from_bytes(raw[1:], "little")

    def _leads_on(self, place: int) -> bool:
        if place == self._size or self._read(place, len(MAGIC)) == MAGIC:
            return True
        opcode, end = self._head(place)
        return opcode in _OPCODES and end <= self._size

    def _search(self, place: int) -> int:
        """Return the next place that looks like a record, or the size."""
        while place < self._size:
            window = self._read(place, _WINDOW + _HEAD - 1)
            found = _CANDIDATE.search(window)
            while found is not None:
                if self._looks_right(place + found.start()):
                    return place + found.start()
                found = _CANDIDATE.search(window, found.start() + 1)
            place += _WINDOW
        return self._size

    def _looks_right(self, place: int) -> bool:
        opcode, end = self._head(place)
        if end > self._size:
            # A chunk may be cut off, if its head says that it is one.
            return opcode == Opcode.CHUNK and not self._inside and bool(self._chunk_head(place))
        length = end - place - _HEAD
        if opcode in _FIXED:
            return length == _FIXED[Opcode(opcode)] and self._leads_on(end)
        if opcode == Opcode.CHUNK:
            return not self._inside and self._is_chunk(place, end)
        if opcode == Opcode.MESSAGE:
            return length >= 22 and self._leads_on(end)
        if opcode == Opcode.MESSAGE_INDEX:
            raw = self._read(place + _HEAD + 2, 4)
            return length >= 6 and int.from_bytes(raw, "little") == length - 6
        return length >= 8 and self._leads_on(end)

    def _read(self, place: int, length: int) -> bytes:
        self._stream.seek(place)
        return self._stream.read(length)


def printable(text: str) -> str:
    """Return a name that a bag gives, without what would command a terminal, 255 characters."""
    return "".join(c if c.isprintable() else "?" for c in text)[:255]
