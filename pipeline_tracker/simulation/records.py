"""The messages of a simulated bag.

Beside the topics of a real vehicle's bag there is the truth:

- ``/ground_truth/pose``: PoseStamped, base_link in world, at each pair's stamp.
- ``/ground_truth/centerline``: Path in world, the stretch of axis in view and a metre more.
- ``/ground_truth/contours/left`` and ``.../right``: PointCloud2 at each pair's stamp in that
  camera's optical frame, two rows (0 left of travel, 1 right), one column for each step along the
  pipe. Fields, float32 each: x y z of the contour point (m), u v its pixel, s its chainage (m),
  flag 0 outside the image, 1 hidden by something before it, 2 visible (which promises no
  contrast).
  With ``camera.distortion`` images and their topics are those of the cameras as they are built
  (``image_raw``; CameraInfo has D, K, R, P), but pixels, flags and frames here are those of the
  *rectified* cameras: what rectification by CameraInfo leads to. The optical frames of
  ``/tf_static`` are the rectified ones too, as they are for stereo_image_proc.
- ``/ground_truth/scenario``: String, the whole scenario as YAML, latched.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    MessageFactory,
    camera_info_message,
    header_message,
    pose_message,
    transforms_message,
)
from pipeline_tracker.simulation.lens import Lens
from pipeline_tracker.simulation.navigation import VnmTrack
from pipeline_tracker.simulation.truth import Contours
from pipeline_tracker.simulation.vehicle_models import CameraModel, SensorModel

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

BASE_LINK, ODOM, WORLD, ALTIMETER = "base_link", "odom", "world", "altimeter"
# What an echo sounder can measure at least, m.
MIN_RANGE = 0.2
OPTICAL = ("stereo_left_optical", "stereo_right_optical")
SIDES = ("left", "right")

_CONTOUR_FIELDS = ("x", "y", "z", "u", "v", "s", "flag")
_FLOAT32 = 7


@dataclass(frozen=True)
class Record:
    """A message of a bag: stamp (ns), topic and message."""

    stamp: int
    topic: str
    message: Any


class Messages:
    """Makes the messages of a simulated bag."""

    def __init__(self, factory: MessageFactory) -> None:
        """Make them with a factory."""
        self._factory = factory

    def mountings(self, stamp: int, mountings: Iterable[tuple[str, Pose]]) -> Record:
        """Return /tf_static with base_link <- the frames named."""
        transforms = transforms_message(self._factory, stamp, BASE_LINK, dict(mountings))
        return Record(stamp, "/tf_static", transforms)

    def scenario(self, stamp: int, text: str) -> Record:
        """Return the scenario as text."""
        message = self._factory.message("std_msgs/msg/String", data=text)
        return Record(stamp, "/ground_truth/scenario", message)

    def image(self, stamp: int, index: int, image: Image, camera: CameraModel) -> Record:
        """Return an image (H, W) or (H, W, 3) BGR uint8, compressed or as it is."""
        quality = camera.jpeg_quality
        encoding = "mono8" if image.ndim == 2 else "bgr8"
        header = self._header(stamp, OPTICAL[index])
        kind = "image_rect" if camera.distortion is None else "image_raw"
        topic = f"/stereo/{SIDES[index]}/{kind}"
        if quality is None:
            message = self._factory.message(
                "sensor_msgs/msg/Image",
                header=header,
                height=image.shape[0],
                width=image.shape[1],
                encoding=encoding,
                step=image[0].nbytes,
                data=image.ravel(),
            )
            return Record(stamp, topic, message)
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        message = self._factory.message(
            "sensor_msgs/msg/CompressedImage",
            header=header,
            format=f"{encoding}; jpeg compressed {encoding}",
            data=np.asarray(data, np.uint8).ravel(),
        )
        return Record(stamp, f"{topic}/compressed", message)

    def camera_info(self, stamp: int, index: int, lens: Lens) -> Record:
        """Return a camera's calibration: P of the rectified camera, K, D and R of its own."""
        message = camera_info_message(self._factory, lens.camera, stamp, OPTICAL[index])
        if not lens.rectified:
            message = dataclasses.replace(
                message,
                distortion_model=lens.model,
                d=self._factory.sequence(lens.coefficients),
                k=lens.matrix.ravel(),
                r=lens.rotation.ravel(),
            )
        return Record(stamp, f"/stereo/{SIDES[index]}/camera_info", message)

    def navigation(self, stamp: int, track: VnmTrack, n: int) -> Iterator[Record]:
        """Yield the VNM's n-th pose, and its odometry with velocities and covariances."""
        make, header = self._factory.message, self._header(stamp, ODOM)
        message = pose_message(self._factory, track.poses[n])
        linear, angular = (
            make("geometry_msgs/msg/Vector3", x=float(v[0]), y=float(v[1]), z=float(v[2]))
            for v in (track.twists[n, :3], track.twists[n, 3:])
        )
        yield Record(
            stamp, "/vnm/pose", make("geometry_msgs/msg/PoseStamped", header=header, pose=message)
        )
        yield Record(
            stamp,
            "/vnm/odometry",
            make(
                "nav_msgs/msg/Odometry",
                header=header,
                child_frame_id=BASE_LINK,
                pose=make(
                    "geometry_msgs/msg/PoseWithCovariance",
                    pose=message,
                    covariance=track.covariances[n].ravel(),
                ),
                twist=make(
                    "geometry_msgs/msg/TwistWithCovariance",
                    twist=make("geometry_msgs/msg/Twist", linear=linear, angular=angular),
                    covariance=track.twist_covariances[n].ravel(),
                ),
            ),
        )

    def altimeter(self, stamp: int, distance: float, sensors: SensorModel) -> Record:
        """Return the echo sounder's range (m), +inf for no echo; its beam is along its own x."""
        message = self._factory.message(
            "sensor_msgs/msg/Range",
            header=self._header(stamp, ALTIMETER),
            radiation_type=0,
            field_of_view=float(np.deg2rad(sensors.altimeter_beam_deg)),
            min_range=MIN_RANGE,
            max_range=sensors.altimeter_reach,
            range=distance,
            variance=sensors.altimeter_noise**2,
        )
        return Record(stamp, "/altimeter/range", message)

    def attitude(self, stamp: int, rotation: Pose, noise: float) -> Record:
        """Return roll and pitch (noise in rad), and a yaw that is not to be trusted."""
        unknown = np.array([-1.0, *np.zeros(8)])
        variance = max(noise**2, 1e-12)
        message = self._factory.message(
            "sensor_msgs/msg/Imu",
            header=self._header(stamp, BASE_LINK),
            orientation=pose_message(self._factory, rotation).orientation,
            orientation_covariance=np.diag([variance, variance, 1.0]).ravel(),
            angular_velocity_covariance=unknown,
            linear_acceleration_covariance=unknown.copy(),
        )
        return Record(stamp, "/attitude", message)

    def true_pose(self, stamp: int, pose: Pose) -> Record:
        """Return world <- base_link."""
        return Record(stamp, "/ground_truth/pose", self._stamped(stamp, pose))

    def centerline(self, stamp: int, points: Array, tangents: Array) -> Record:
        """Return a stretch of the axis: points and tangents (S, 3), world."""
        poses = []
        for point, tangent in zip(points, tangents, strict=True):
            yaw = np.arctan2(tangent[1], tangent[0])
            pitch = -np.arcsin(np.clip(tangent[2], -1.0, 1.0))
            poses.append(self._stamped(stamp, Pose.from_rpy(point, [0.0, pitch, yaw])))
        message = self._factory.message(
            "nav_msgs/msg/Path", header=self._header(stamp, WORLD), poses=poses
        )
        return Record(stamp, "/ground_truth/centerline", message)

    def contours(self, stamp: int, index: int, contours: Contours) -> Record:
        """Return the contours in one image; see this module's text."""
        make = self._factory.message
        sides, count = contours.flags.shape
        chainage = np.broadcast_to(contours.chainage, (sides, count))[..., None]
        flags = contours.flags[..., None].astype(np.float64)
        data = np.concatenate((contours.points, contours.pixels, chainage, flags), axis=-1)
        data = data.astype("<f4")
        fields = [
            make("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=_FLOAT32, count=1)
            for i, name in enumerate(_CONTOUR_FIELDS)
        ]
        step = 4 * len(_CONTOUR_FIELDS)
        message = make(
            "sensor_msgs/msg/PointCloud2",
            header=self._header(stamp, OPTICAL[index]),
            height=sides,
            width=count,
            fields=fields,
            point_step=step,
            row_step=step * count,
            data=np.frombuffer(data.tobytes(), np.uint8),
        )
        return Record(stamp, f"/ground_truth/contours/{SIDES[index]}", message)

    def _header(self, stamp: int, frame: str) -> Any:
        return header_message(self._factory, stamp, frame)

    def _stamped(self, stamp: int, pose: Pose) -> Any:
        return self._factory.message(
            "geometry_msgs/msg/PoseStamped",
            header=self._header(stamp, WORLD),
            pose=pose_message(self._factory, pose),
        )
