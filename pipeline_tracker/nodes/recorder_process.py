"""`run --record`: what is recorded, and the process that does it, seen from `run`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

from pipeline_tracker.bags.topics import POSE_TYPES
from pipeline_tracker.errors import BagError
from pipeline_tracker.nodes.process import CHILD_VARIABLE, say
from pipeline_tracker.replay.result_bag import TOPICS
from pipeline_tracker.settings import Settings

# What is left in memory after the nodes have ended is written within this time, s.
_END_WITHIN = 20.0


@dataclass(frozen=True)
class RecordedTopic:
    """A topic to record.

    Attributes:
        name: relative to the namespace, but for those of all vehicles.
        type_name: ``package/msg/Name``.
        profile: of its quality of service: pipeline, sensor, pose or static.
    """

    name: str
    type_name: str
    profile: str


def recorded_topics(settings: Settings, *, images: bool) -> list[RecordedTopic]:
    """Return what is recorded: all results, and the input that a replay needs beside the images.

    Args:
        settings: mode, pose type, transport and rectification of the images.
        images: record the images too.
    """
    topics = [RecordedTopic(name[1:], kind, "pipeline") for name, kind in TOPICS.items()]
    topics.append(RecordedTopic("vnm/pose", POSE_TYPES[settings.pose_type], "pose"))
    if settings.mode == "mono":
        topics.append(RecordedTopic("altimeter/range", "sensor_msgs/msg/Range", "sensor"))
    raw = settings.image_transport == "raw"
    image = "image_raw" if settings.camera.rectify else "image_rect"
    for side in ("left", "right") if settings.mode == "stereo" else ("left",):
        name = f"stereo/{side}/camera_info"
        topics.append(RecordedTopic(name, "sensor_msgs/msg/CameraInfo", "sensor"))
        if images:
            name = f"stereo/{side}/{image}" + ("" if raw else "/compressed")
            kind = "sensor_msgs/msg/Image" if raw else "sensor_msgs/msg/CompressedImage"
            topics.append(RecordedTopic(name, kind, "sensor"))
    topics.append(RecordedTopic("/tf", "tf2_msgs/msg/TFMessage", "pipeline"))
    topics.append(RecordedTopic("/tf_static", "tf2_msgs/msg/TFMessage", "static"))
    # tf2_msgs is not installed everywhere.
    return [topic for topic in topics if find_spec(topic.type_name.partition("/")[0]) is not None]


def check_directory(directory: Path) -> None:
    """Check that a recording can be begun there.

    Raises:
        BagError: something is there already, or the place cannot be written to.
    """
    if directory.exists():
        raise BagError(f"{directory}: is there already; name another directory with --record")
    place = next(parent for parent in directory.resolve().parents if parent.exists())
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise BagError(
            f"{directory}: cannot be written ({place} is not a directory that may be written to); "
            "name another with --record"
        )


class RecorderProcess:
    """A process of its own that records; it ends with this one, however this one ends."""

    def __init__(
        self,
        directory: Path,
        topics: Sequence[RecordedTopic],
        ros_args: Sequence[str],
        *,
        quiet: bool = False,
    ) -> None:
        """Start it.

        Args:
            directory: of the bag; created.
            topics: what to record.
            ros_args: with ``--ros-args``: remappings, namespace.
            quiet: it says nothing but errors.
        """
        plan = json.dumps([asdict(topic) for topic in topics])
        module = "pipeline_tracker.nodes.recorder"
        # A session of its own: Ctrl-C reaches `run` alone, and the nodes' last words are recorded.
        self._process = subprocess.Popen(  # noqa: S603 - our own module
            [sys.executable, "-m", module, str(directory), plan, *ros_args],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if quiet else None,
            env={**os.environ, CHILD_VARIABLE: "1"},
            start_new_session=True,
        )

    def end(self) -> int:
        """Let it write what it has; return 0 where all is well, else 1."""
        assert self._process.stdin is not None  # noqa: S101 - a pipe was asked for
        self._process.stdin.close()
        try:
            code = self._process.wait(_END_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if code < 0:
            # It could not say so itself.
            say("the recording was killed; `salvage` reads what is there", error=True)
        return int(code != 0)
