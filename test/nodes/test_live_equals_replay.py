"""Live nodes and replay give the same numbers on the same bag, in one process and in four.

PIPELINE_TRACKER_BAG=/path/of/a/bag, with PIPELINE_TRACKER_SET="key=value key=value" for its
settings, compares another bag than bags/demo; ``pytest -s`` shows the largest differences.
"""

from __future__ import annotations

import math
import os
import re
import sys
from array import array
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.messages import header_message, stamp_ns
from pipeline_tracker.replay import replay
from pipeline_tracker.replay.result_bag import TOPICS
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import load_settings

pytestmark = [pytest.mark.ros, pytest.mark.timeout(900)]

ROOT = Path(__file__).resolve().parents[2]
BAG = Path(os.environ.get("PIPELINE_TRACKER_BAG", ROOT / "bags" / "demo"))
SETTINGS = os.environ.get("PIPELINE_TRACKER_SET", "pipe.diameter=0.6").split()
TOLERANCE = 1e-6
# A frame is answered before the next one is sent: any machine holds that, and none is dropped.
UNDER_WAY = 1
# Pings of two seconds come at once here, and none may be lost.
PINGS = "qos_overrides./altimeter/range.subscription"
KEEP_PINGS = ["--ros-args", "-p", f"{PINGS}.reliability:=reliable", "-p", f"{PINGS}.depth:=1000"]
SECOND = 1_000_000_000
COMPRESSED = "sensor_msgs/msg/CompressedImage"


@dataclass(frozen=True)
class Replayed:
    """A replay of the bag: its settings with topics and mounting, and its messages by topic."""

    file: Path
    settings: Settings
    messages: dict[str, list[Any]]

    @property
    def stamps(self) -> list[int]:
        return [stamp_ns(m.header) for m in self.messages["/pipeline/status"]]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    output = tmp_path_factory.mktemp("replay") / "out"
    with Path(os.devnull).open("w") as nowhere:
        replay(BAG, load_settings(None, SETTINGS), output, stream=nowhere)
    messages = defaultdict(list)
    with BagReader(output / "result") as result:
        for record in result.records(list(TOPICS)):
            messages[record.topic].append(record.unpack())
    return Replayed(output / "settings.yaml", load_settings(output / "settings.yaml"), messages)


def pairs(live: Any, offline: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield every field of two messages, of rclpy and of rosbags, with its path."""
    if hasattr(live, "get_fields_and_field_types"):
        for name in live.get_fields_and_field_types():
            # How long it took is no result; nor which of the same camera infos came last.
            if name != "processing_time" and not path.endswith("_info.header"):
                yield from pairs(getattr(live, name), getattr(offline, name), f"{path}.{name}")
    elif isinstance(live, list) and live and hasattr(live[0], "get_fields_and_field_types"):
        assert len(live) == len(offline), path
        for index, (one, other) in enumerate(zip(live, offline, strict=True)):
            yield from pairs(one, other, f"{path}[{index}]")
    elif isinstance(live, str) or not hasattr(live, "__len__"):
        yield path, live, offline
    else:
        yield path, np.asarray(live, dtype=float), np.asarray(offline, dtype=float)


def compare(topic: str, live: Any, offline: Any, worst: dict[str, float]) -> None:
    """Compare two messages field by field and note the largest difference of each field."""
    for path, value, other in pairs(live, offline):
        key = re.sub(r"\[\d+\]", "[]", f"{topic}{path}")
        if isinstance(value, np.ndarray):
            assert value.shape == other.shape, key
            apart = float(np.max(np.abs(value - other), initial=0.0))
        elif isinstance(value, float):
            apart = abs(value - other)
        else:
            assert value == other, key
            continue
        assert math.isfinite(apart), key
        worst[key] = max(worst.get(key, 0.0), apart)


def is_of(message: Any, stamps: set[int]) -> bool:
    """Whether a message belongs to one of the frames; a number alone does not say."""
    if hasattr(message, "markers"):
        message = message.markers[0]
    if hasattr(message, "data"):
        return True
    return stamp_ns(getattr(message, "header", message)) in stamps


class Feeder:
    """Publishes the bag's own bytes and keeps what the nodes say."""

    def __init__(self, talker: Any, bag: BagReader, done: Replayed) -> None:
        self.talker = talker
        self.bag = bag
        self.expected = done.stamps
        topics = done.settings.topics
        self.left = topics.left_image
        image = "image_raw" if done.settings.camera.rectify else "image_rect"
        wanted = {
            topics.left_image: f"stereo/left/{image}",
            topics.right_image: f"stereo/right/{image}",
            topics.left_info: "stereo/left/camera_info",
            topics.right_info: "stereo/right/camera_info",
            topics.pose: "vnm/pose",
            topics.range: "altimeter/range",
        }
        self.names = {name: live for name, live in wanted.items() if name}
        self.compressed = bag.topics[self.left].type_name == COMPRESSED
        for name in (topics.left_image, topics.right_image):
            if name and self.compressed:
                self.names[name] += "/compressed"
        for name, live in self.names.items():
            talker.publisher(live, bag.topics[name].type_name)
        for name, kind in TOPICS.items():
            talker.hear(name.lstrip("/"), kind)

    def publish(self, topic: str, raw: Any) -> None:
        name = self.names[topic]
        self.talker.publisher(name, self.bag.topics[topic].type_name).publish(raw)

    def connect(self) -> None:
        """Wait until the way through all nodes is open.

        A black picture of long before goes from node to node and leaves no trace: no pipe is found
        in it, and it has no pose.
        """
        from pipeline_tracker.nodes.conversions import LiveMessages, message_class

        subscriptions = self.talker.node.subscriptions
        poses = 2
        self.talker.wait(
            lambda: (
                all(s.get_publisher_count() for s in subscriptions)
                and all(
                    p.get_subscription_count() >= (poses if name == "vnm/pose" else 1)
                    for name, p in self.talker._publishers.items()
                )
            ),
            "all topics matched",
        )
        factory = LiveMessages()
        infos = [name for name, live in self.names.items() if live.endswith("camera_info")]
        images = [name for name, live in self.names.items() if "/image_" in live]
        size = self.bag.first(infos[0])
        black = np.zeros((size.height, size.width), np.uint8)
        for probe in range(60):
            stamp = self.expected[0] - (1000 - probe) * SECOND
            header = header_message(factory, stamp, "")
            if self.compressed:
                data = array("B", cv2.imencode(".png", black)[1].tobytes())
                image = message_class(COMPRESSED)(header=header, format="png", data=data)
            else:
                image = message_class("sensor_msgs/msg/Image")(
                    header=header,
                    height=size.height,
                    width=size.width,
                    step=size.width,
                    encoding="mono8",
                    data=array("B", black.tobytes()),
                )
            for record in self.first_records(infos):
                self.publish(record.topic, bytes(record.raw))
            for name in images:
                self.publish(name, image)
            try:
                self.talker.wait(lambda stamp=stamp: stamp in self.answered(), "", within=2.0)
            except AssertionError:
                continue
            return
        raise AssertionError(f"the way is not open: {self.talker.counts()}")

    def first_records(self, names: list[str]) -> list[Any]:
        return [next(iter(self.bag.records([name], complete=False))) for name in names]

    def answered(self) -> set[int]:
        return {stamp_ns(m.header) for m in self.talker.got["pipeline/relative_state"]}

    def feed(self) -> None:
        """Publish the whole bag."""
        under_way: list[int] = []
        for record in self.bag.records(list(self.names)):
            if record.topic == self.left:
                self.talker.wait(
                    lambda: len(set(under_way) - self.answered()) < UNDER_WAY,
                    f"answers to {under_way[-UNDER_WAY:]}",
                )
                stamp = stamp_ns(record.unpack().header)
                if stamp in self.expected:
                    under_way.append(stamp)
            self.publish(record.topic, bytes(record.raw))
        assert under_way == self.expected
        self.talker.wait(lambda: set(under_way) <= self.answered(), "the last answers")

    def heard(self, topic: str, frames: set[int], count: int) -> list[Any]:
        """Return the messages of a topic once there are so many."""

        def found() -> list[Any]:
            return [m for m in self.talker.got[topic[1:]] if is_of(m, frames)]

        self.talker.wait(lambda: len(found()) >= count, f"{count} of {topic}")
        return found()


@pytest.mark.parametrize("separate", [False, True], ids=["one process", "four processes"])
def test_live_equals_replay(bench: Any, replayed: Replayed, separate: bool) -> None:
    with BagReader(BAG) as bag:
        feeder = Feeder(bench.talker(), bag, replayed)
        arguments = ["run", "--config", str(replayed.file)]
        arguments += ["--set", f"image_transport={'compressed' if feeder.compressed else 'raw'}"]
        arguments += ["--separate"] if separate else []
        arguments += KEEP_PINGS if replayed.settings.topics.range else []
        process = bench.process(f"from pipeline_tracker.cli import main; main({arguments!r})")
        process.wait_for(lambda text: text.count("]: ready") == 4, "all nodes are ready")
        feeder.connect()
        feeder.feed()
        # States of silence, and of the black picture, are in no replay.
        frames = set(feeder.expected)
        worst: dict[str, float] = {}
        for topic, offline in replayed.messages.items():
            live = feeder.heard(topic, frames, len(offline))
            for one, other in zip(live, offline, strict=True):
                compare(topic, one, other, worst)
        assert process.end()[0] == 0
        assert process.text.count("\n") == 4, process.text
    how = "four processes" if separate else "one process"
    lines = [f"{apart:8.1e}  {key}" for key, apart in sorted(worst.items())]
    sys.stdout.write("\n  ".join([f"\n{BAG.name}, {how}: {len(frames)} frames", *lines]) + "\n")
    if BAG.name == "demo":
        assert set(replayed.messages) == set(TOPICS)
    assert max(worst.values()) <= TOLERANCE
