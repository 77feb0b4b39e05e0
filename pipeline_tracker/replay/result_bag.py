"""result/: a bag of all pipeline topics, as the live nodes would have published them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from typing_extensions import Self

from pipeline_tracker import messages
from pipeline_tracker.bags.foxglove import IMAGE_ANNOTATIONS
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.markers import Centerline, markers_message
from pipeline_tracker.replay.input import Frame
from pipeline_tracker.replay.results import BAG_KEY
from pipeline_tracker.replay.steady_writer import SteadyWriter
from pipeline_tracker.report.annotations import annotations_message
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
# What the nodes publish.
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
# What comes beside it: the VNM's pose at each image's stamp, the frames, and for people to look at
# the left image with what was found in it.
POSE = "/vnm/pose"
TRANSFORMS, MOUNTING = "/tf", "/tf_static"
LEFT_IMAGE = "/pipeline/debug/left/image/compressed"
LEFT_INFO = "/pipeline/debug/left/camera_info"
ANNOTATIONS = "/pipeline/debug/left/annotations"
EXTRA_TOPICS = {
    POSE: "geometry_msgs/msg/PoseStamped",
    TRANSFORMS: "tf2_msgs/msg/TFMessage",
    MOUNTING: "tf2_msgs/msg/TFMessage",
    ANNOTATIONS: IMAGE_ANNOTATIONS,
    LEFT_INFO: "sensor_msgs/msg/CameraInfo",
}
_JPEG_QUALITY = 80
# A player of the bag offers it to those that come late, as ROS does.
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.AUTOMATIC,
    QosTime(0, 0),
    avoid_ros_namespace_conventions=False,
)


class ResultBag:
    """Writes the result bag frame by frame; a context manager.

    It is closed whole even when an error ends the replay, so that it can be read. Where the disk
    does not allow that, or the process is killed, what was saved before can still be salvaged.
    """

    def __init__(
        self, path: Path, settings: Settings, left_frame: str, mounting: Pose, bag: Path
    ) -> None:
        """Remember what to write; ``__enter__`` creates the directory.

        Args:
            path: the bag's directory; it must not exist.
            settings: names of frames, width of the images.
            left_frame: name of the left optical frame.
            mounting: base_link <- left optical frame.
            bag: what is replayed; named in the metadata.
        """
        self._factory = BagMessages()
        self._settings = settings
        self._left_frame = left_frame
        self._mounting = mounting
        self._begun = False
        self._centerline = Centerline()
        self._writer = SteadyWriter(path)
        self._writer.set_custom_data(BAG_KEY, str(bag.resolve()))
        self._broken = False
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        """Create the bag.

        Raises:
            OSError: it cannot be written.
        """
        self._writer.open()
        kinds = {**TOPICS, **EXTRA_TOPICS}
        if self._settings.result.image_width:
            kinds[LEFT_IMAGE] = "sensor_msgs/msg/CompressedImage"
        for topic, type_name in kinds.items():
            self._connections[topic] = self._writer.add_connection(
                topic,
                type_name,
                typestore=self._factory.store,
                offered_qos_profiles=[LATCHED] if topic == MOUNTING else (),
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the bag with index and metadata.

        Raises:
            OSError: these cannot be written.
        """
        try:
            if not self._broken:
                with self._unless_broken():
                    self._writer.close()
        finally:
            if self._broken:
                self._writer.give_up()

    def save(self) -> None:
        """See to it that all frames so far are still there when the power fails.

        Raises:
            OSError: the bag cannot be written.
        """
        with self._unless_broken():
            self._writer.save()

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
            frame: the input, whose camera infos and left image are passed on.
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

        self._write_frames(stamp, pose)
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
        self._write_picture(frame, vectorized.rig.left)
        drawn = annotations_message(
            factory, vectorized.rig.left, self._mounting, status, segment, state
        )
        self._put(ANNOTATIONS, stamp, drawn)

    def _write_frames(self, stamp: int, pose: Pose | None) -> None:
        """Write where base_link is in odom, and once where the camera is in base_link."""
        factory, names = self._factory, self._settings.frames

        def transform(parent: str, child: str, placed: Pose) -> Any:
            return messages.transforms_message(factory, stamp, parent, {child: placed})

        if not self._begun:
            self._put(MOUNTING, stamp, transform(names.base_link, self._left_frame, self._mounting))
            self._begun = True
        if pose is not None:
            message = messages.pose_stamped_message(factory, pose, stamp, names.odom)
            self._put(POSE, stamp, message)
            self._put(TRANSFORMS, stamp, transform(names.odom, names.base_link, pose))

    def _write_picture(self, frame: Frame, camera: Camera) -> None:
        """Write the left image, made smaller, with the camera info of its full size.

        Foxglove spreads an image over the size that its camera info says: annotations are in the
        pixels of the camera, and fit the images of the replayed bag too.
        """
        width, stamp = self._settings.result.image_width, frame.stamp_ns
        if not width or frame.left is None:
            return
        image = frame.left
        if width < image.shape[1]:
            size = width, max(1, round(image.shape[0] * width / image.shape[1]))
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        picture = self._factory.message(
            "sensor_msgs/msg/CompressedImage",
            header=messages.header_message(self._factory, stamp, self._left_frame),
            format="jpeg",
            data=data.ravel(),
        )
        self._put(LEFT_IMAGE, stamp, picture)
        info = messages.camera_info_message(self._factory, camera, stamp, self._left_frame)
        self._put(LEFT_INFO, stamp, info)

    def _put(self, topic: str, stamp: int, message: Any) -> None:
        data = self._factory.serialize(message)
        with self._unless_broken():
            self._writer.write(self._connections[topic], stamp, data)

    @contextmanager
    def _unless_broken(self) -> Iterator[None]:
        """Remember that the file has half a chunk in it."""
        try:
            yield
        except OSError:
            self._broken = True
            raise
