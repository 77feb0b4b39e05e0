"""Writing the records of a sea to a bag."""

from __future__ import annotations

from collections.abc import Iterable
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
