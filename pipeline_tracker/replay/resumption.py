"""Going on with a replay that was broken off: by a kill, a power loss, a full disk or Ctrl-C.

What costs most of a frame, vectorization and recognition, does not depend on the frames before, and
the result bag holds both. A resumed replay goes through the bag from its beginning, takes these two
from the earlier result bag, and tracks anew: its tracker is in the state of an unbroken replay's
because it came there in the same way. The earlier rows of estimates.csv are the proof: each must
come out again.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message

from pipeline_tracker.bags.scan import RecordScan
from pipeline_tracker.bags.typestore import our_typestore
from pipeline_tracker.errors import BagError
from pipeline_tracker.messages import segment_from_message, vectorized_from_message
from pipeline_tracker.replay.estimates import KeptRows
from pipeline_tracker.replay.record import RECORD, check_record
from pipeline_tracker.replay.result_bag import TOPICS
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dotted_values, load_settings
from pipeline_tracker.types import PipeSegment, VectorizedStereo

# The result bag of the replay that was broken off, until the new one holds as much.
BEFORE = "result_before"
GONE = ".result_gone"


@dataclass(frozen=True)
class Answer:
    """What was computed for a frame, and does not depend on those before.

    Attributes:
        vectorized: segments and matches of its images.
        recognition: the recognizer's answer; None where it was not asked.
    """

    vectorized: VectorizedStereo
    recognition: PipeSegment | None


class Resumption:
    """A replay that was broken off, in its directory.

    Attributes:
        finished: whether it has ended after all.
        frames: number of frames whose answers are taken over; 0 before ``begin``.
    """

    def __init__(self, output: Path, *, finished: bool) -> None:
        """Remember the directory; see ``find``."""
        self._output = output
        self.finished = finished
        self.frames = 0
        self._answers: Iterator[Answer] = iter(())
        self._next: Answer | None = None

    @classmethod
    def find(cls, output: Path, bag: Path) -> Resumption | None:
        """Look for a replay of a bag; None where there is none, nor anything else.

        Raises:
            BagError: the directory was made of another bag, by another version or by no replay.
            OSError: it cannot be read.
        """
        if (output / RECORD).exists() and (output / "settings.yaml").exists():
            return cls(output, finished=check_record(output, bag))
        # A replay that was killed at its very beginning has left nothing that counts.
        names = [file.name for file in output.iterdir()] if output.is_dir() else []
        if any(name != RECORD and not name.startswith(".") for name in names):
            raise BagError(
                f"{output}: there is no replay to resume in it (no {RECORD}); name its directory "
                "with --output, or replace an earlier replay with --force"
            )
        return None

    def check_settings(self, settings: Settings) -> None:
        """Check that settings are those of the replay.

        Raises:
            BagError: one is another.
            SettingsError: those of the replay cannot be read.
        """
        old = dotted_values(load_settings(self._output / "settings.yaml"))
        for name, value in dotted_values(settings).items():
            if old[name] != value:
                raise BagError(
                    f"{self._output}: cannot be resumed with {name}={value}, it was {old[name]}; "
                    "give the same settings, or none, or begin again with --force"
                )

    def begin(self) -> KeptRows | None:
        """Put the result bag aside and return the rows that are there; None without any.

        Raises:
            OSError: it cannot be done.
        """
        result, before = self._output / "result", self._output / BEFORE
        shutil.rmtree(self._output / GONE, ignore_errors=True)
        if before.exists():
            # Resumed before, and broken off again while the new bag held less.
            shutil.rmtree(result, ignore_errors=True)
        elif result.exists():
            result.rename(before)
        table = self._output / "estimates.csv"
        if not table.exists():
            return None
        rows = KeptRows(table)
        self.frames = rows.settled
        self._answers = _answers(before)
        self._next = next(self._answers, None)
        return rows

    def answer(self, stamp_ns: int) -> Answer | None:
        """Return what was computed for the next frame; None where that is not known."""
        if self._next is None or self._next.vectorized.stamp_ns != stamp_ns:
            return None
        found, self._next = self._next, next(self._answers, None)
        return found

    def caught_up(self) -> None:
        """Let go of the earlier result bag: the new one holds as much.

        Raises:
            OSError: it cannot be moved.
        """
        self._answers, self._next = iter(()), None
        before, gone = self._output / BEFORE, self._output / GONE
        if before.exists():
            # Moved first: it is never seen half.
            before.rename(gone)
            shutil.rmtree(gone, ignore_errors=True)


def earlier_settings(output: Path) -> dict[str, Any]:
    """Return the settings of the replay in a directory by dotted key; none where there is none.

    Raises:
        SettingsError: they cannot be read.
    """
    path = output / "settings.yaml"
    values = dotted_values(load_settings(path)) if path.exists() else {}
    return {name: value for name, value in values.items() if value is not None}


def _answers(bag: Path) -> Iterator[Answer]:
    """Yield what a result bag, cut off or not, holds of each frame that is whole, in its order."""
    for file in sorted(bag.glob("*.mcap")):
        topics: dict[int, str] = {}
        with file.open("rb") as stream:
            held: Answer | None = None
            for record in RecordScan(stream, file.stat().st_size).records():
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    topic = topics.get(record.channel_id, "")
                    # A frame's status follows what the tracker was given.
                    if topic == "/pipeline/status" and held is not None:
                        yield held
                    held = _with(held, topic, record.data)


def _with(held: Answer | None, topic: str, data: bytes) -> Answer | None:
    """Return what is known of a frame after one more message."""
    if topic not in {"/pipeline/vectorized", "/pipeline/recognition"}:
        return None if topic == "/pipeline/status" else held
    try:
        message = our_typestore().deserialize_cdr(data, TOPICS[topic])
        if topic == "/pipeline/vectorized":
            return Answer(vectorized_from_message(message), None)
        return None if held is None else Answer(held.vectorized, segment_from_message(message))
    except Exception:  # noqa: BLE001 - damaged bytes raise anything
        # The frame is computed anew.
        return None
