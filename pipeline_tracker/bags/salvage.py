"""Every readable message of a damaged bag, written as a sound one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from mcap.records import Channel, Message, MessageIndex, Schema, Statistics
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from pipeline_tracker.bags.definitions import TopicKind, topic_kind
from pipeline_tracker.bags.fresh import fresh_bag
from pipeline_tracker.bags.scan import RecordScan, printable
from pipeline_tracker.errors import BagError

# Later times cannot be written to a bag.
_LAST_NS = 2**62
_LARGEST_METADATA = 2**20


@dataclass(frozen=True)
class SavedTopic:
    """What was saved of a topic.

    Attributes:
        name: its name.
        saved: messages written.
        lost: messages that the damaged bag says it had, less those; at least the unreadable ones.
    """

    name: str
    saved: int
    lost: int


@dataclass
class Salvaged:
    """What came of it.

    Attributes:
        output: directory of the new bag.
        topics: sorted by name.
        counted: whether the damaged bag still says how many messages it had; else ``lost`` counts
            only those whose remains were seen.
        notes: what else was left out, one line each.
    """

    output: Path
    topics: list[SavedTopic] = field(default_factory=list)
    counted: bool = True
    notes: list[str] = field(default_factory=list)

    def in_words(self) -> str:
        """Return the counts for a person."""
        width = max(len(topic.name) for topic in self.topics)
        sign = "" if self.counted else "at least "
        lines = [f"{t.name:<{width}}  {t.saved} saved, {sign}{t.lost} lost" for t in self.topics]
        lines += self.notes
        saved, lost = (sum(getattr(t, what) for t in self.topics) for what in ("saved", "lost"))
        lines.append(f"{saved} messages saved, {sign}{lost} lost; written to {self.output}")
        return "\n".join(lines)


def salvage(bag: Path, output: Path) -> Salvaged:
    """Write what can be read of a damaged bag to a new one.

    A message is kept if it is whole and fits the definition of its type. A chunk whose checksum
    does not fit is left out: which of its numbers are right cannot be told.

    Args:
        bag: directory or .mcap file; neither index, summary nor metadata.yaml is needed.
        output: directory to write; new or empty.

    Raises:
        BagError: nothing can be saved, or ``output`` cannot be written.
    """
    files = _files(bag)
    if output.is_dir() and bag.exists() and output.resolve() == bag.resolve():
        raise BagError(f"{output}: is the bag itself; name another directory with --output")
    work = _Work()
    with fresh_bag(output) as place:
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for file in files:
                _File(file, work).copy(writer)
        if not work.saved:
            reasons = "; ".join(work.notes) or "no whole message is in it"
            raise BagError(f"{bag}: nothing can be saved ({reasons})")
    return work.result(bag, output)


class _Work:
    """Counts over all files of a bag."""

    def __init__(self) -> None:
        self.connections: dict[tuple[str, str], Connection] = {}
        self.saved: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self.expected: Counter[str] = Counter()
        self.counted = True
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        if text not in self.notes and len(self.notes) < 20:
            self.notes.append(text)

    def result(self, bag: Path, output: Path) -> Salvaged:
        by_metadata = _counts_of_metadata(bag / "metadata.yaml")
        expected = self.expected if by_metadata is None else self.expected | by_metadata
        topics = [
            SavedTopic(
                name,
                self.saved[name],
                max(expected[name] - self.saved[name], self.unreadable[name]),
            )
            for name in sorted({*self.saved, *self.unreadable, *expected})
        ]
        return Salvaged(output, topics, self.counted or by_metadata is not None, self.notes)


class _File:
    """One file of the bag: its definitions first, wherever they stand, then its messages."""

    def __init__(self, path: Path, work: _Work) -> None:
        self._path = path
        self._work = work
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._kinds: dict[int, TopicKind | None] = {}

    def copy(self, writer: Writer) -> None:
        try:
            with self._path.open("rb") as stream:
                size = self._path.stat().st_size
                self._survey(RecordScan(stream, size))
                for message in _messages(RecordScan(stream, size)):
                    self._put(writer, message)
        except PermissionError as error:
            raise BagError(f"{self._path}: cannot be read ({error.strerror})") from None

    def _survey(self, scan: RecordScan) -> None:
        statistics: dict[int, int] | None = None
        indexed: Counter[int] = Counter()
        for record in scan.records():
            if isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self._channels.setdefault(record.id, record)
            elif isinstance(record, Statistics):
                statistics = record.channel_message_counts
            elif isinstance(record, MessageIndex):
                indexed[record.channel_id] += len(record.records)
        for identity, channel in self._channels.items():
            self._kinds[identity] = self._kind(channel)
        counts = indexed if statistics is None else statistics
        self._work.counted &= statistics is not None
        for identity, count in counts.items():
            self._work.expected[self._name(identity)] += count
        for reason in scan.refused:
            self._work.note(f"{self._path.name}: left out, {reason}")
        if scan.broken:
            self._work.note(f"{self._path.name}: damaged in {scan.broken} places")

    def _kind(self, channel: Channel) -> TopicKind | None:
        try:
            return topic_kind(channel, self._schemas.get(channel.schema_id))
        except BagError as error:
            self._work.note(f"{self._path.name}: {printable(channel.topic)} left out, {error}")
            return None

    def _name(self, identity: int) -> str:
        channel = self._channels.get(identity)
        return "(topic not known)" if channel is None else printable(channel.topic)

    def _put(self, writer: Writer, message: Message) -> None:
        kind = self._kinds.get(message.channel_id)
        if kind is None or message.log_time > _LAST_NS or not kind.fits(message.data):
            self._work.unreadable[self._name(message.channel_id)] += 1
            return
        key = kind.topic, kind.type_name
        connections = self._work.connections
        if key not in connections:
            connections[key] = writer.add_connection(
                kind.topic, kind.type_name, typestore=kind.store, offered_qos_profiles=kind.qos
            )
        writer.write(connections[key], message.log_time, message.data)
        self._work.saved[kind.topic] += 1


def _messages(scan: RecordScan) -> Iterator[Message]:
    for record in scan.records():
        if isinstance(record, Message):
            yield record


def _files(bag: Path) -> list[Path]:
    try:
        if bag.is_dir():
            files = sorted(file for file in bag.iterdir() if file.suffix == ".mcap")
        else:
            bag.stat()
            files = [bag] if bag.suffix == ".mcap" else []
    except OSError as error:
        raise BagError(f"{bag}: cannot be read ({error.strerror})") from None
    if not files:
        raise BagError(f"{bag}: nothing to save, expected a .mcap file or a directory that has one")
    return files


def _counts_of_metadata(path: Path) -> Counter[str] | None:
    """Return the number of messages by topic as metadata.yaml has it; None where it has not."""
    try:
        if path.stat().st_size > _LARGEST_METADATA:
            return None
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        topics = content["rosbag2_bagfile_information"]["topics_with_message_count"]
        counts: Counter[str] = Counter()
        for topic in topics:
            name = printable(str(topic["topic_metadata"]["name"]))
            counts[name] += max(0, int(topic["message_count"]))
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):
        return None
    return counts
