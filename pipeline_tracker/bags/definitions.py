"""What a message of a damaged bag must fit before it is kept."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from mcap.records import Channel, Schema
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pipeline_tracker.bags.typestore import our_typestore
from pipeline_tracker.errors import BagError

_TOPIC = re.compile(r"[/~A-Za-z_][/~A-Za-z0-9_{}]{0,254}")
_TYPE = re.compile(r"[A-Za-z][A-Za-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*")
_LARGEST_TEXT = 2**20
_SEPARATOR = "=" * 80 + "\n"


@dataclass(frozen=True)
class TopicKind:
    """A topic and how its messages are read.

    Attributes:
        topic, type_name: names.
        store: knows the type.
        qos: the profiles that the publishers offered; empty where they are not known.
    """

    topic: str
    type_name: str
    store: Typestore
    qos: tuple[Qos, ...]

    def fits(self, raw: bytes) -> bool:
        """Return whether bytes are a whole message of the type."""
        try:
            self.store.deserialize_cdr(raw, self.type_name)
        except Exception:  # noqa: BLE001 - damaged bytes raise anything
            return False
        return True


def topic_kind(channel: Channel, schema: Schema | None) -> TopicKind:
    """Return how the messages of a channel are read.

    Raises:
        BagError: its name, encoding or definition is damaged, or not of ROS 2.
    """
    if not _TOPIC.fullmatch(channel.topic):
        raise BagError("the name of its topic is damaged")
    if channel.message_encoding != "cdr":
        raise BagError(f"encoded as {channel.message_encoding[:20]!r}, expected 'cdr'")
    if schema is None or not _TYPE.fullmatch(schema.name):
        raise BagError("its type is not known")
    store = _store(schema)
    return TopicKind(channel.topic, schema.name, store, _qos(channel))


def _store(schema: Schema) -> Typestore:
    known = our_typestore()
    try:
        types = _types(schema)
        store = get_typestore(Stores.EMPTY)
        store.register(types)
        store.hash_rihs01(schema.name)
    except Exception:  # noqa: BLE001 - damaged text raises anything
        if schema.name in known.fielddefs:
            return known
        raise BagError(f"the definition of {schema.name} cannot be read") from None
    return store


def _types(schema: Schema) -> dict[str, Any]:
    if len(schema.data) > _LARGEST_TEXT:
        raise BagError(f"the definition of {schema.name} has {len(schema.data)} bytes")
    text = schema.data.decode()
    if schema.encoding == "ros2msg":
        return dict(get_types_from_msg(text, schema.name))
    if schema.encoding != "ros2idl":
        raise BagError(f"a definition by {schema.encoding[:20]!r}, expected 'ros2msg'")
    types: dict[str, Any] = {}
    parts = text.split(_SEPARATOR)[1:] if text.startswith(_SEPARATOR) else [f"\n{text}"]
    for part in parts:
        types.update(get_types_from_idl(part.split("\n", 1)[1]))
    return types


def _qos(channel: Channel) -> tuple[Qos, ...]:
    try:
        return tuple(parse_qos(channel.metadata.get("offered_qos_profiles", "")))
    except Exception:  # noqa: BLE001 - damaged text raises anything
        return ()
