"""Small bags for tests, of any shape and with any fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from pipeline_tracker import messages
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose

FACTORY = BagMessages()
START = 1_710_000_000_000_000_000
SECOND = 1_000_000_000
WIDTH, HEIGHT = 64, 48
LEFT = Camera(80.0, 80.0, 31.5, 23.5, WIDTH, HEIGHT)
RIGHT = replace(LEFT, offset=0.2)
MOUNTING = Pose.from_rpy([0.3, 0.1, -0.1], [-2.618, 0.0, -1.571])
FRAME = "left_optical"

TYPES = {
    "raw": "sensor_msgs/msg/Image",
    "compressed": "sensor_msgs/msg/CompressedImage",
    "info": "sensor_msgs/msg/CameraInfo",
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
}


@dataclass(frozen=True)
class Item:
    """A message to write: topic, type, time of recording in ns, and message or raw bytes."""

    topic: str
    type_name: str
    log_ns: int
    message: Any


@dataclass(frozen=True)
class Sea:
    """What a test bag holds; each field may be changed.

    ``level`` gives the grey level of frame i: tests tell frames apart, and a stand-in for the
    pipeline finds a pipe in the bright ones.
    """

    frames: int = 4
    period: float = 0.5
    encoding: str = "mono8"
    pose: str = "pose"
    pose_topic: str = "/vnm/pose"
    static: bool = True
    sides: tuple[str, ...] = ("left", "right")
    image_topic: str = "/stereo/{side}/image_rect"
    info_topic: str = "/stereo/{side}/camera_info"
    level: Callable[[int], int] = field(default=lambda i: 150 + i % 50)
    size: tuple[int, int] = (WIDTH, HEIGHT)

    def stamp(self, index: int) -> int:
        """Stamp of frame ``index``, ns."""
        return START + round(index * self.period * SECOND)

    def items(self) -> Iterator[Item]:
        """Yield all messages in the order of recording."""
        if self.static:
            yield static_transform(START, "base_link", FRAME, MOUNTING)
        for index in range(self.frames):
            stamp = self.stamp(index)
            for side in self.sides:
                yield self.info(side, index)
                yield self.image(side, index)
            if self.pose:
                yield self.pose_item(index, stamp)

    def image(self, side: str, index: int, stamp: int | None = None) -> Item:
        """Return an image message of a camera."""
        stamp = self.stamp(index) if stamp is None else stamp
        pixels = picture(self.level(index), self.size)
        topic = self.image_topic.format(side=side)
        if self.encoding in ("jpeg", "png"):
            message = compressed_image(stamp, pixels, self.encoding)
            return Item(f"{topic}/compressed", TYPES["compressed"], stamp, message)
        return Item(topic, TYPES["raw"], stamp, raw_image(stamp, pixels, self.encoding))

    def info(self, side: str, index: int, camera: Camera | None = None) -> Item:
        """Return a camera info."""
        camera = camera or (RIGHT if side == "right" else LEFT)
        camera = replace(camera, width=self.size[0], height=self.size[1])
        stamp = self.stamp(index)
        message = messages.camera_info_message(FACTORY, camera, stamp, FRAME)
        return Item(self.info_topic.format(side=side), TYPES["info"], stamp, message)

    def pose_item(self, index: int, stamp: int) -> Item:
        """Return a pose of the type that the bag has."""
        pose = Pose.from_rpy([0.2 * index, 0.0, 0.0], [0.0, 0.0, 0.1])
        return pose_item(self.pose_topic, self.pose, stamp, pose)


def picture(
    level: int, size: tuple[int, int] = (WIDTH, HEIGHT)
) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return a grey image with some texture."""
    noise = np.random.default_rng(level).integers(0, 20, size[::-1])
    return np.clip(noise + level - 10, 0, 255).astype(np.uint8)


def raw_image(stamp: int, grey: Any, encoding: str = "mono8", frame: str = FRAME) -> Any:
    """Return sensor_msgs/Image."""
    data = grey
    if encoding in ("bgr8", "rgb8"):
        data = np.repeat(grey[..., None], 3, axis=2)
    elif encoding == "mono16":
        data = grey.astype("<u2") * 257
    return FACTORY.message(
        TYPES["raw"],
        header=messages.header_message(FACTORY, stamp, frame),
        height=grey.shape[0],
        width=grey.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=data.nbytes // grey.shape[0],
        data=np.frombuffer(data.tobytes(), np.uint8),
    )


def compressed_image(stamp: int, grey: Any, kind: str) -> Any:
    """Return sensor_msgs/CompressedImage."""
    extension = ".png" if kind == "png" else ".jpg"
    _, data = cv2.imencode(extension, grey)
    return FACTORY.message(
        TYPES["compressed"],
        header=messages.header_message(FACTORY, stamp, FRAME),
        format=f"mono8; {kind} compressed mono8",
        data=data.ravel(),
    )


def pose_item(topic: str, kind: str, stamp: int, pose: Pose) -> Item:
    """Return a pose message of one of the three types."""
    header = messages.header_message(FACTORY, stamp, "odom")
    inner = messages.pose_message(FACTORY, pose)
    if kind != "pose":
        inner = FACTORY.message("geometry_msgs/msg/PoseWithCovariance", pose=inner)
    return Item(topic, TYPES[kind], stamp, FACTORY.message(TYPES[kind], header=header, pose=inner))


def static_transform(stamp: int, parent: str, child: str, pose: Pose) -> Item:
    """Return a message of /tf_static with one transform."""
    inner = messages.pose_message(FACTORY, pose)
    position = inner.position
    transform = FACTORY.message(
        "geometry_msgs/msg/TransformStamped",
        header=messages.header_message(FACTORY, stamp, parent),
        child_frame_id=child,
        transform=FACTORY.message(
            "geometry_msgs/msg/Transform",
            translation=FACTORY.message(
                "geometry_msgs/msg/Vector3", x=position.x, y=position.y, z=position.z
            ),
            rotation=inner.orientation,
        ),
    )
    message = FACTORY.message(TYPES["tf"], transforms=[transform])
    return Item("/tf_static", TYPES["tf"], stamp, message)


def write_bag(
    path: Path,
    items: Iterable[Item] | None = None,
    *,
    storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.NONE,
    silent: Mapping[str, str] | None = None,
) -> Path:
    """Write a bag directory and return its path; ``silent`` topics, with types, are empty."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {
            topic: writer.add_connection(topic, type_name, typestore=FACTORY.store)
            for topic, type_name in (silent or {}).items()
        }
        for item in Sea().items() if items is None else items:
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(
                    item.topic, item.type_name, typestore=FACTORY.store
                )
            raw = item.message
            if not isinstance(raw, bytes):
                raw = FACTORY.serialize(raw)
            writer.write(connections[item.topic], item.log_ns, raw)
    return path


def write_small_chunks(path: Path, sea: Sea, compression: CompressionType, **options: Any) -> Path:
    """Write an mcap file of many chunks with another library than ours; return its path."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=4096, compression=compression, **options)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for item in sea.items():
            if item.topic not in channels:
                text, _ = FACTORY.store.generate_msgdef(item.type_name, ros_version=2)
                schema = writer.register_schema(item.type_name, "ros2msg", text.encode())
                channels[item.topic] = writer.register_channel(item.topic, "cdr", schema)
            data = FACTORY.serialize(item.message)
            writer.add_message(channels[item.topic], item.log_ns, data, item.log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def mcap_of(bag: Path) -> Path:
    """Return the single .mcap file of a bag directory."""
    (file,) = bag.glob("*.mcap")
    return file
