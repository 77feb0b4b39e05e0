"""Message types for bags: ROS 2 Jazzy's and our own, without ROS."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pipeline_tracker.bags.foxglove import foxglove_types
from pipeline_tracker.resources import message_directory

OUR_PACKAGE = "pipeline_tracker_msgs"
# Fields that distributions before Jazzy have not, and that nothing here reads.
_NEWER = {("sensor_msgs/msg/Range", "variance")}


@lru_cache(maxsize=1)
def our_typestore() -> Typestore:
    """Return a type store with ROS 2 Jazzy's types, ours and Foxglove's image annotations.

    Raises:
        ResourceError: our message definitions are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    types = foxglove_types()
    for file in sorted(message_directory().glob("*.msg")):
        name = f"{OUR_PACKAGE}/msg/{file.stem}"
        types.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    store.register(types)
    return store


@lru_cache(maxsize=64)
def missing_field(store: Typestore, type_name: str) -> str:
    """Return a field that a bag's definition of a type lacks and ours has; empty: none.

    A definition comes with the bag: it may be another version's, damaged, or hostile. Types that
    are not ours lack nothing.

    Args:
        store: with the bag's definitions.
        type_name: ``package/msg/Name``.
    """
    ours = our_typestore().fielddefs.get(type_name)
    theirs = store.fielddefs.get(type_name)
    if ours is None or theirs is None:
        return ""
    # ROS 1 writes some in capitals.
    names = {name.lower() for name, _ in theirs[1]}
    for name, (kind, described) in ours[1]:
        if name not in names and (type_name, name) not in _NEWER:
            return f"{type_name}.{name}"
        # Of an array: what its elements are.
        node: Any = (
            described[0] if kind in {Nodetype.ARRAY, Nodetype.SEQUENCE} else (kind, described)
        )
        if node[0] is Nodetype.NAME and (inner := missing_field(store, node[1])):
            return inner
    return ""


class BagMessages:
    """Makes rosbags messages; a ``MessageFactory``."""

    def __init__(self, store: Typestore | None = None) -> None:
        """Use a type store, ours by default."""
        self.store = store or our_typestore()

    def message(self, type_name: str, /, **fields: Any) -> Any:
        """Return a message; fields left out have ROS's defaults."""
        for name, node in self.store.fielddefs[type_name][1]:
            if name not in fields:
                fields[name] = self._default(node)
        return self.store.types[type_name](**fields)

    def sequence(self, values: NDArray[Any], /) -> NDArray[Any]:
        """Return the array itself: rosbags writes arrays."""
        return values

    def serialize(self, message: Any) -> bytes:
        """Return a message as CDR."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def _default(self, node: Any) -> Any:
        kind, description = node
        if kind == Nodetype.BASE:
            name = description[0]
            return {"string": "", "bool": False}.get(name, 0.0 if name.startswith("float") else 0)
        if kind == Nodetype.NAME:
            return self.message(description)
        inner, length = description
        count = length if kind == Nodetype.ARRAY else 0
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            return np.zeros(count, dtype=np.dtype(inner[1][0]))
        return [self._default(inner) for _ in range(count)]
