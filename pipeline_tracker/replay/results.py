"""What a replay wrote of each frame, read again from its result bag."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import BagError
from pipeline_tracker.messages import (
    relative_state_from_message,
    segment_from_message,
    stamp_ns,
    status_from_message,
    vectorized_from_message,
)
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.tracking.tracker import TrackedFrame

# Key of the replayed bag's path among the custom data of result/metadata.yaml.
BAG_KEY = "pipeline_tracker_replay_of"

_READERS = {
    "/pipeline/vectorized": vectorized_from_message,
    "/pipeline/segment": segment_from_message,
    "/pipeline/status": status_from_message,
    "/pipeline/relative_state": relative_state_from_message,
}
# The last of them is written last.
_LAST = "/pipeline/relative_state"
# Frames that are held for one that is asked for out of order.
_HELD = 64


def check_replay(directory: Path) -> None:
    """Check that a directory is the output of a replay.

    Raises:
        BagError: it is not.
    """
    for name in ("settings.yaml", "estimates.csv", "result"):
        if not (directory / name).exists():
            raise BagError(
                f"{directory}: no {name} in it; expected the output directory of "
                "`pipeline-tracker replay`"
            )


def replayed_bag(directory: Path) -> Path:
    """Return the bag that a replay has read.

    Args:
        directory: the output of the replay.

    Raises:
        BagError: it is not known, or no longer there.
    """
    metadata = directory / "result" / "metadata.yaml"
    try:
        document = yaml.safe_load(metadata.read_bytes())
        known = document["rosbag2_bagfile_information"]["custom_data"][BAG_KEY]
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        raise BagError(
            f"{directory}: it does not say which bag was replayed; name it with --bag"
        ) from None
    path = Path(str(known))
    if not path.exists():
        raise BagError(f"{path}: the replayed bag is no longer there; name it with --bag")
    return path


class StoredResults:
    """The results of a replay by stamp, read one after another; few are held at a time."""

    def __init__(self, reader: BagReader) -> None:
        """Read from an open result bag.

        Raises:
            BagError: it lacks a topic.
        """
        missing = [topic for topic in (*_READERS,) if topic not in reader.topics]
        if missing:
            raise BagError(f"{reader.path}: no {missing[0]} in it; replay again")
        self._reader = reader
        self.rewind()

    def rewind(self) -> None:
        """Begin again: the stamps that are asked for next are not later than those before."""
        self._records = self._read()
        self._held: OrderedDict[int, FrameResult] = OrderedDict()

    def at(self, stamp: int) -> FrameResult | None:
        """Return what was written of a frame; None where nothing was.

        Args:
            stamp: of the left image, ns; in the order of the replay.

        Raises:
            BagError: the bag is damaged.
        """
        while stamp not in self._held:
            item = next(self._records, None)
            if item is None:
                return None
            self._held[item[0]] = item[1]
            if len(self._held) > _HELD:
                self._held.popitem(last=False)
            # A frame that was lost has no result: what comes later is kept for its own turn.
            if item[0] > stamp:
                break
        return self._held.pop(stamp, None)

    def _read(self) -> Iterator[tuple[int, FrameResult]]:
        open_frames: dict[int, dict[str, Any]] = {}
        for record in self._reader.records(_READERS):
            message = record.unpack()
            stamp = stamp_ns(message.header)
            parts = open_frames.setdefault(stamp, {})
            parts[record.topic] = _READERS[record.topic](message)
            if record.topic == _LAST:
                yield from _whole(stamp, open_frames.pop(stamp))


def _whole(stamp: int, parts: dict[str, Any]) -> Iterator[tuple[int, FrameResult]]:
    vectorized, status = parts.get("/pipeline/vectorized"), parts.get("/pipeline/status")
    if vectorized is None or status is None:
        return
    tracked = TrackedFrame(status, parts.get("/pipeline/segment"))
    yield stamp, FrameResult(vectorized, None, tracked, parts[_LAST])
