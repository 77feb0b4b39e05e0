"""What is in a bag, what a replay would take of it, and what is missing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.scan import RecordScan, printable
from pipeline_tracker.bags.topics import CAMERA_INFO, COMPRESSED_IMAGE, POSE_TYPES, RAW_IMAGE
from pipeline_tracker.errors import BagError, PipelineTrackerError
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.settings import Settings

# Their messages begin with a header, so that stamps can be read without unpacking.
_STAMPED = {RAW_IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, *POSE_TYPES.values()}


@dataclass
class TopicInfo:
    """A topic of a bag.

    Attributes:
        name, type: as the bag has them; type empty where several share the name.
        summary: number of messages by the bag's summary; None where it has none.
        count: number of messages that are there.
        rate: messages per second between the first and the last; None below two.
        longest_gap: the longest time between two, s; None below two.
        back: how many stamps are not later than the one before; None where there are no stamps.
    """

    name: str
    type: str
    summary: int | None = None
    count: int = 0
    rate: float | None = None
    longest_gap: float | None = None
    back: int | None = None


@dataclass
class BagInfo:
    """What `info` says.

    Attributes:
        bag: path.
        seconds: from the first message to the last.
        topics: sorted by name.
        damage: what is wrong with the bag itself, one line each.
        replay: what a replay would use, by name of the setting; empty where it would refuse.
        missing: what a replay lacks, one line each.
    """

    bag: str
    seconds: float = 0.0
    topics: list[TopicInfo] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    replay: dict[str, Any] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return it as values for JSON."""
        return asdict(self)

    def in_words(self) -> str:
        """Return it for a person."""
        total = sum(topic.count for topic in self.topics)
        lines = [f"{self.bag}: {total} messages, {self.seconds:.1f} s"]
        width = max((len(topic.name) for topic in self.topics), default=0)
        lines += [f"  {_topic_in_words(topic, width)}" for topic in self.topics]
        lines += [f"damage: {line}" for line in self.damage]
        if self.replay:
            lines.append("replay would use:")
            lines += [f"  {key}: {_value(value)}" for key, value in self.replay.items()]
        lines += [f"missing: {line}" for line in self.missing]
        if self.replay and not self.missing and not self.damage:
            lines.append("nothing is missing for a replay")
        return "\n".join(lines)


def bag_info(bag: Path, settings: Settings, *, has_diameter: bool) -> BagInfo:
    """Look into a bag; every message is read, none unpacked but what calibration needs.

    Args:
        bag: directory or file.
        settings: what a replay would be given.
        has_diameter: whether ``pipe.diameter`` was given; else it is missing.

    Raises:
        BagError: there is no bag, or nothing in it can be read.
    """
    info = BagInfo(printable(str(bag)))
    try:
        with BagReader(bag) as reader:
            _count(reader, info)
            _look(reader, settings, info)
    except BagError as error:
        if not _scan(bag, info):
            raise
        info.damage.append(str(error))
    if not has_diameter:
        info.missing.append("pipe.diameter is not in a bag; give it with --set pipe.diameter=...")
    return info


class _Clock:
    """Times of one topic."""

    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = 0
        self.gap = 0
        self.back = 0
        self._stamp: int | None = None

    def tick(self, log_ns: int) -> None:
        if self.count:
            self.gap = max(self.gap, log_ns - self.last)
        else:
            self.first = log_ns
        self.last = log_ns
        self.count += 1

    def stamp(self, stamp_ns: int) -> None:
        if self._stamp is not None and stamp_ns <= self._stamp:
            self.back += 1
        self._stamp = stamp_ns

    def describe(self, topic: TopicInfo, *, stamped: bool) -> None:
        topic.count = self.count
        topic.back = self.back if stamped else None
        if self.count >= 2:
            topic.longest_gap = self.gap / SECOND_NS
            if self.last > self.first:
                topic.rate = (self.count - 1) * SECOND_NS / (self.last - self.first)


def _count(reader: BagReader, info: BagInfo) -> None:
    clocks = {name: _Clock() for name in reader.topics}
    try:
        for record in reader.records(reader.topics):
            clock = clocks[record.topic]
            clock.tick(record.log_ns)
            if record.type_name in _STAMPED:
                clock.stamp(record.stamp_guess())
    except BagError as error:
        info.damage.append(str(error))
    for name, topic in reader.topics.items():
        shown = TopicInfo(printable(name), printable(topic.type_name), topic.count)
        clocks[name].describe(shown, stamped=topic.type_name in _STAMPED)
        info.topics.append(shown)
        if not topic.type_name:
            info.damage.append(f"{shown.name}: several types share this name, it is not read")
    info.seconds = _seconds(clocks.values())


def _look(reader: BagReader, settings: Settings, info: BagInfo) -> None:
    try:
        source = ReplayInput(reader, settings)
    except PipelineTrackerError as error:
        info.missing.append(str(error))
        has_transforms = any(name.endswith("/tf_static") for name in reader.topics)
        if settings.camera.translation is None and not has_transforms:
            info.missing.append(
                "the camera's mounting: no /tf_static; give camera.translation and "
                "camera.rotation_rpy"
            )
        return
    topics, rig, found = source.topics, source.rig, source.settings
    assert rig is not None  # noqa: S101 - an impossible one was refused
    info.replay = {
        "mode": "stereo" if topics.right_image else "mono",
        "topics.left_image": topics.left_image,
        "topics.right_image": topics.right_image or None,
        "topics.left_info": topics.left_info,
        "topics.right_info": topics.right_info or None,
        "topics.pose": topics.pose or None,
        "pose_type": topics.pose_type,
        "topics.range": topics.range or None,
        "image size": [rig.left.width, rig.left.height],
        "focal length": [rig.left.fx, rig.left.fy],
        "baseline": rig.baseline if topics.right_image else None,
        "frames.left_optical": source.left_frame,
        "camera.translation": list(found.camera.translation or ()),
        "camera.rotation_rpy": list(found.camera.rotation_rpy or ()),
    }
    if not topics.pose:
        info.missing.append("vehicle poses: each frame would be recognised by itself")
    _compare_sides(reader.topics, topics.left_image, topics.right_image, info)


def _compare_sides(topics: Mapping[str, Any], left: str, right: str, info: BagInfo) -> None:
    if right and topics[left].count != topics[right].count:
        info.missing.append(
            f"partner images: {topics[left].count} of {left}, {topics[right].count} of {right}"
        )


def _scan(bag: Path, info: BagInfo) -> bool:
    """Fill in the topics of a bag that cannot be opened; return whether any was found."""
    files = [bag] if bag.suffix == ".mcap" else []
    clocks: dict[tuple[str, str], _Clock] = {}
    try:
        if bag.is_dir():
            files = sorted(file for file in bag.iterdir() if file.suffix == ".mcap")
        for file in files:
            _scan_file(file, clocks)
    except OSError:
        return False
    info.topics = []
    for (name, kind), clock in sorted(clocks.items()):
        topic = TopicInfo(printable(name), printable(kind))
        clock.describe(topic, stamped=False)
        info.topics.append(topic)
    info.seconds = _seconds(clocks.values())
    return bool(info.topics)


def _seconds(clocks: Iterable[_Clock]) -> float:
    used = [clock for clock in clocks if clock.last]
    if not used:
        return 0.0
    return (max(c.last for c in used) - min(c.first for c in used)) / SECOND_NS


def _scan_file(file: Path, clocks: dict[tuple[str, str], _Clock]) -> None:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, int]] = {}
    unknown: Counter[int] = Counter()
    with file.open("rb") as stream:
        for record in RecordScan(stream, file.stat().st_size).records():
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                channels[record.id] = record.topic, record.schema_id
            elif isinstance(record, Message) and record.channel_id in channels:
                topic, schema = channels[record.channel_id]
                key = topic, schemas.get(schema, "")
                clocks.setdefault(key, _Clock()).tick(record.log_time)
            elif isinstance(record, Message):
                unknown[record.channel_id] += 1
    for identity, count in unknown.items():
        topic, schema = channels.get(identity, ("(topic not known)", -1))
        clock = clocks.setdefault((topic, schemas.get(schema, "")), _Clock())
        clock.count += count


def _topic_in_words(topic: TopicInfo, width: int) -> str:
    parts = [f"{topic.name:<{width}}  {topic.count}"]
    if topic.summary is not None and topic.summary != topic.count:
        parts[0] += f" of {topic.summary}"
    if topic.rate is not None:
        parts.append(f"at {topic.rate:.2f} Hz")
    if topic.longest_gap is not None:
        parts.append(f"longest gap {topic.longest_gap:.2f} s")
    if topic.back:
        parts.append(f"{topic.back} stamps not later than the one before")
    return f"{', '.join(parts)}  {topic.type or '(several types)'}"


def _value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))
