"""Reading bags: one error type, and no message lost in silence.

Whatever rosbags reads: a directory or a single .mcap or .db3 file, split or not, chunks compressed
by zstd or lz4, files or messages compressed by zstd, and ROS 1 .bag files.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from typing_extensions import Self

from pipeline_tracker.bags.bounds import bound_unpacking, check_chunks
from pipeline_tracker.bags.typestore import missing_field, our_typestore
from pipeline_tracker.errors import BagError, PipelineTrackerError

_STORAGES = (".mcap", ".db3")
_EXPECTED = "expected a bag: a directory with metadata.yaml, or a .mcap or .db3 file"
# Descriptions of types that mcap files may have, and that are not of ROS 2.
_FOREIGN = ("protobuf", "flatbuffer", "jsonschema", "ros1msg")
# What rosbags says of a file whose end is missing.
_TRUNCATED = ("end magic", "truncated", "footer", "unpack requires", "argument must be")

bound_unpacking()


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag.

    Attributes:
        name: topic name.
        type_name: ``package/msg/Name``; empty where several types share the name.
        count: number of messages by the bag's own summary.
    """

    name: str
    type_name: str
    count: int


@dataclass(frozen=True)
class BagRecord:
    """A message of a bag, not yet unpacked.

    Attributes:
        topic: topic name.
        type_name: ``package/msg/Name``.
        log_ns: when it was recorded, ns.
        raw: its bytes.
        reader: the reader that it comes from.
    """

    topic: str
    type_name: str
    log_ns: int
    raw: bytes
    reader: AnyReader

    def unpack(self) -> Any:
        """Return the message.

        Raises:
            BagError: its bytes don't fit its type.
        """
        known = self.type_name in self.reader.typestore.fielddefs
        missing = missing_field(self.reader.typestore, self.type_name)
        if missing:
            raise BagError(
                f"a message of {self.topic} ({self.type_name}) cannot be read: the bag's own "
                f"definition of its type has no {missing}"
            )
        try:
            if known:
                return self.reader.deserialize(self.raw, self.type_name)
            return our_typestore().deserialize_cdr(self.raw, self.type_name)
        except Exception as error:  # noqa: BLE001 - damaged bytes raise anything
            raise BagError(
                f"a message of {self.topic} ({self.type_name}) cannot be read ({_described(error)})"
            ) from None

    def stamp_guess(self) -> int:
        """Return the stamp in ns of a message that cannot be unpacked.

        A header comes first in a message, and its stamp first in a header; else the time when it
        was recorded.
        """
        if self.reader.is2 and len(self.raw) >= 12:
            order = "<" if self.raw[1] & 1 else ">"
            sec, nanosec = struct.unpack_from(f"{order}iI", self.raw, 4)
            stamp = sec * 1_000_000_000 + nanosec
            if nanosec < 1_000_000_000 and abs(stamp - self.log_ns) < 3600 * 1_000_000_000:
                return int(stamp)
        return self.log_ns


class BagReader:
    """A bag that is open for reading; a context manager."""

    def __init__(self, path: Path) -> None:
        """Remember the path; nothing is opened yet."""
        self.path = path
        self.topics: dict[str, BagTopic] = {}
        self._readers: list[AnyReader] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Open the bag.

        Raises:
            BagError: there is no bag, or it is truncated, damaged or of another kind.
        """
        try:
            for paths in _storages(self.path):
                with self._library(opening=True):
                    reader = AnyReader([paths], default_typestore=our_typestore())
                    self._stack.enter_context(reader)
                    self._readers.append(reader)
                self._check_chunks(reader)
            self._readers.sort(key=lambda reader: reader.start_time)
            self._list_topics()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self._stack.close()

    @property
    def start_ns(self) -> int:
        """When the first message was recorded, ns."""
        return min(reader.start_time for reader in self._readers)

    @property
    def end_ns(self) -> int:
        """When the last message was recorded, ns."""
        return max(reader.end_time for reader in self._readers)

    def records(self, topics: Collection[str], *, complete: bool = True) -> Iterator[BagRecord]:
        """Yield the messages of some topics in the order in which they were recorded.

        Args:
            topics: topic names.
            complete: count what was read, and check it against the bag's summary at the end.

        Raises:
            BagError: the bag is damaged, or gives fewer messages than its summary says.
        """
        counts: Counter[str] = Counter()
        for reader in self._readers:
            wanted = [c for c in reader.connections if c.topic in topics]
            if not wanted:
                continue
            self._check_encoding(wanted)
            for connection, log_ns, raw in self._guarded(reader, wanted):
                counts[connection.topic] += 1
                yield BagRecord(connection.topic, connection.msgtype, log_ns, raw, reader)
        for name in sorted(topics) if complete else ():
            expected = self.topics[name].count
            if counts[name] < expected:
                raise BagError(
                    f"{self.path}: damaged, {counts[name]} of the {expected} messages of {name} "
                    f"can be read; {self._salvage()}"
                )

    def first(self, topic: str) -> Any:
        """Return the first message of a topic that can be unpacked.

        Raises:
            BagError: there is none, or the bag is damaged.
        """
        reason = "it has none"
        for record in self.records([topic], complete=False):
            try:
                return record.unpack()
            except BagError as error:  # noqa: PERF203 - the first one is enough, nearly always
                reason = str(error)
        raise BagError(f"{self.path}: no message of {topic} can be read ({reason})")

    def _guarded(
        self, reader: AnyReader, connections: list[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        messages = reader.messages(connections)
        while True:
            with self._library(opening=False):
                item = next(messages, None)
            if item is None:
                return
            yield item

    def _check_encoding(self, connections: list[Connection]) -> None:
        for connection in connections:
            encoding = getattr(connection.ext, "serialization_format", "cdr")
            if encoding != "cdr":
                raise BagError(
                    f"{self.path}: {connection.topic} is encoded as {encoding[:40]!r}, expected "
                    "'cdr' as ROS 2 records it; convert the bag"
                )

    def _check_chunks(self, reader: AnyReader) -> None:
        try:
            check_chunks(reader)
        except BagError as error:
            raise BagError(self._damaged(str(error))) from None

    def _list_topics(self) -> None:
        counts: Counter[str] = Counter()
        types: dict[str, set[str]] = {}
        for reader in self._readers:
            for connection in reader.connections:
                counts[connection.topic] += connection.msgcount
                types.setdefault(connection.topic, set()).add(connection.msgtype)
        for name in sorted(types):
            kinds = types[name]
            type_name = next(iter(kinds)) if len(kinds) == 1 else ""
            self.topics[name] = BagTopic(name, type_name, counts[name])
        if not sum(counts.values()):
            raise BagError(f"{self.path}: the bag is empty, it has no messages; record it again")

    @contextmanager
    def _library(self, *, opening: bool) -> Iterator[None]:
        """Turn whatever the libraries raise into a BagError."""
        try:
            yield
        except BagError as error:
            # One of the bounds.
            raise BagError(self._damaged(str(error))) from None
        except PipelineTrackerError:
            raise
        except PermissionError as error:
            raise BagError(f"{self.path}: cannot be read ({error.strerror})") from None
        except Exception as error:  # noqa: BLE001 - damaged bytes raise anything
            raise BagError(self._reason(error, opening=opening)) from None

    def _reason(self, error: Exception, *, opening: bool) -> str:
        described = _described(error)
        low = described.lower()
        if "file magic is invalid" in low or "not a database" in low:
            return f"{self.path}: not a bag ({described}); {_EXPECTED}"
        if any(word in low for word in ("profile is not", "not supported", "unrecognized")):
            return f"{self.path}: a bag of another kind ({described}); expected a ROS 2 bag"
        if isinstance(error, KeyError) and opening and error.args and error.args[0] in _FOREIGN:
            return (
                f"{self.path}: its types are described by {described.split()[-1]}, expected "
                "ros2msg or ros2idl; convert the bag"
            )
        if "are missing" in low:
            return f"{self.path}: {described}; copy the whole directory"
        if opening and any(word in low for word in _TRUNCATED):
            return f"{self.path}: the bag is truncated ({described}); {self._salvage()}"
        return self._damaged(described)

    def _damaged(self, why: str) -> str:
        return f"{self.path}: the bag is damaged ({why}); {self._salvage()}"

    def _salvage(self) -> str:
        return (
            "write what can be read of it to a new bag with "
            f"`pipeline-tracker salvage {self.path} --output DIR`"
        )


def _storages(path: Path) -> list[Path]:
    """Return what to open: the bag itself, or the files of a directory without metadata.yaml."""
    try:
        if path.is_dir():
            return _of_directory(path)
        size = path.stat().st_size
    except FileNotFoundError:
        raise BagError(f"{path}: no such file or directory; {_EXPECTED}") from None
    except OSError as error:
        raise BagError(f"{path}: cannot be read ({error.strerror})") from None
    if path.suffix not in (*_STORAGES, ".bag"):
        raise BagError(f"{path}: not a bag, its name ends with {path.suffix!r}; {_EXPECTED}")
    if size == 0:
        raise BagError(f"{path}: the file is empty; {_EXPECTED}")
    return [path]


def _of_directory(path: Path) -> list[Path]:
    files = sorted(file for file in path.iterdir() if file.suffix in _STORAGES)
    empty = next((file for file in files if file.stat().st_size == 0), None)
    if empty is not None:
        raise BagError(f"{empty}: the file is empty; {_EXPECTED}")
    if (path / "metadata.yaml").exists():
        return [path]
    if not files:
        raise BagError(
            f"{path}: no bag in this directory (neither metadata.yaml nor a .mcap or .db3 file)"
        )
    # A recorder that was killed leaves no metadata.yaml; the files speak for themselves.
    return files


def _described(error: Exception) -> str:
    text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    if isinstance(error, (MemoryError, RecursionError)):
        text = f"{type(error).__name__} while reading"
    elif type(error).__module__.split(".")[0] != "rosbags":
        text = f"{type(error).__name__}: {text}"
    return text if len(text) <= 200 else f"{text[:197]}..."
