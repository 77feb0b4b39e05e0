"""Writing a bag whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer

from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.errors import BagError
from pipeline_tracker.simulation.records import Record

_FOREVER = QosTime(sec=2147483647, nsec=4294967295)
_LATCHED = (
    Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    ),
)
_LATCHED_TOPICS = ("/tf_static", "/ground_truth/scenario")


@contextmanager
def fresh_bag(output: Path) -> Iterator[Path]:
    """Give a place to write a bag to, and put the bag in its place once it is whole.

    The bag is written beside ``output`` and moved there when the block ends; when it ends with an
    error or is interrupted nothing is left behind.

    Raises:
        BagError: ``output`` is a file or a directory that is not empty, or cannot be written.
    """
    output = output.resolve()
    try:
        if output.is_dir() and any(output.iterdir()):
            raise BagError(f"{output} is not empty; give another --output or remove it first")
        if output.exists() and not output.is_dir():
            raise BagError(f"{output} is a file, expected a new directory; give another --output")
        output.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{output.name}-", dir=output.parent))
        try:
            # The bag's files carry its directory's name, so it has that name already.
            yield scratch / output.name
            if output.is_dir():
                output.rmdir()
            (scratch / output.name).replace(output)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise BagError(
            f"{output} cannot be written ({error.strerror or error}); "
            "give another --output, or make room"
        ) from error


def write_bag(path: Path, factory: BagMessages, records: Iterable[Record]) -> None:
    """Write records, which come in time order, to a new rosbag2 directory (mcap)."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Connection] = {}
        for record in records:
            if record.topic not in connections:
                connections[record.topic] = writer.add_connection(
                    record.topic,
                    record.message.__msgtype__,
                    typestore=factory.store,
                    offered_qos_profiles=_LATCHED if record.topic in _LATCHED_TOPICS else (),
                )
            data = factory.serialize(record.message)
            writer.write(connections[record.topic], record.stamp, data)
