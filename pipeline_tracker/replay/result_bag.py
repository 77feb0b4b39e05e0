"""result/: a bag of all pipeline topics, as the live nodes would have published them."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from typing_extensions import Self

from pipeline_tracker import messages
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.markers import Centerline, markers_message
from pipeline_tracker.replay.input import Frame
from pipeline_tracker.replay.results import BAG_KEY
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import (
    PipeSegment,
    RelativeState,
    TrackingStatus,
    VectorizedStereo,
)

# Single numbers, each with the variance that says whether it is known.
_FLOATS = {
    "heading_misalignment": "heading_variance",
    "pitch_misalignment": "pitch_variance",
    "approach_speed": "speed_variance",
    "min_distance": "distance_variance",
}
# What the nodes publish; the VNM's pose at each image's stamp comes beside it.
POSE = "/vnm/pose"
TOPICS = {
    "/pipeline/vectorized": "pipeline_tracker_msgs/msg/VectorizedStereo",
    "/pipeline/recognition_request": "std_msgs/msg/Header",
    "/pipeline/recognition": "pipeline_tracker_msgs/msg/PipeSegment",
    "/pipeline/segment": "pipeline_tracker_msgs/msg/PipeSegment",
    "/pipeline/status": "pipeline_tracker_msgs/msg/TrackingStatus",
    "/pipeline/relative_state": "pipeline_tracker_msgs/msg/RelativeState",
    **{f"/pipeline/{name}": "std_msgs/msg/Float64" for name in _FLOATS},
    "/pipeline/centerline": "nav_msgs/msg/Path",
    "/pipeline/markers": "visualization_msgs/msg/MarkerArray",
}


class ResultBag:
    """Writes the result bag frame by frame; a context manager.

    It is closed whole even when an error ends the replay, so that it can be read.
    """

    def __init__(self, path: Path, settings: Settings, left_frame: str, bag: Path) -> None:
        """Remember what to write; ``__enter__`` creates the directory.

        Args:
            path: the bag's directory; it must not exist.
            settings: names of frames.
            left_frame: name of the left optical frame.
            bag: what is replayed; named in the metadata.
        """
        self._factory = BagMessages()
        self._settings = settings
        self._left_frame = left_frame
        self._centerline = Centerline()
        self._writer = Writer(
            path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
        )
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.set_custom_data(BAG_KEY, str(bag.resolve()))
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        """Create the bag.

        Raises:
            OSError: it cannot be written.
        """
        self._writer.open()
        for topic, type_name in {**TOPICS, POSE: "geometry_msgs/msg/PoseStamped"}.items():
            self._connections[topic] = self._writer.add_connection(
                topic, type_name, typestore=self._factory.store
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the bag with index and metadata."""
        self._writer.close()

    def write(
        self,
        frame: Frame,
        vectorized: VectorizedStereo,
        recognition: PipeSegment | None,
        status: TrackingStatus,
        segment: PipeSegment | None,
        state: RelativeState,
        pose: Pose | None,
    ) -> None:
        """Write all messages of a frame, with its stamp as the time of recording.

        Args:
            frame: the input, whose camera infos are passed on.
            vectorized: the vectorized pair.
            recognition: the recognizer's answer; None where it was not asked.
            status, segment, state: what the tracker and the estimator said.
            pose: odom <- base_link, None without.

        Raises:
            OSError: the bag cannot be written.
        """
        factory, stamp = self._factory, frame.stamp_ns
        base, odom = self._settings.frames.base_link, self._settings.frames.odom

        def put(name: str, message: Any) -> None:
            self._put(f"/pipeline/{name}", stamp, message)

        if pose is not None:
            self._put(POSE, stamp, messages.pose_stamped_message(factory, pose, stamp, odom))
        put(
            "vectorized",
            messages.vectorized_message(
                factory, vectorized, self._left_frame, frame.left_info, frame.right_info
            ),
        )
        if recognition is not None:
            put("recognition_request", messages.header_message(factory, stamp, self._left_frame))
            put("recognition", messages.segment_message(factory, recognition, base))
        if segment is not None:
            put("segment", messages.segment_message(factory, segment, base))
        put("status", messages.status_message(factory, status, base))
        put("relative_state", messages.relative_state_message(factory, state, base))
        for name, variance in _FLOATS.items():
            if state.valid and getattr(state, variance) >= 0.0:
                put(name, messages.float_message(factory, getattr(state, name)))
        if self._centerline.update(state, segment, pose):
            put("centerline", self._centerline.message(factory, stamp, odom))
        put("markers", markers_message(factory, status, segment, state, base))

    def _put(self, topic: str, stamp: int, message: Any) -> None:
        self._writer.write(self._connections[topic], stamp, self._factory.serialize(message))
