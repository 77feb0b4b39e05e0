"""Images, camera infos, poses, transforms and ranges, as vehicles send them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import CalibrationError, ImageError
from pipeline_tracker.validation.fields import (
    check_covariance,
    check_finite,
    check_point,
    check_quaternion,
    check_stamp,
    refuse,
)

Array = NDArray[np.float64]

BYTES_PER_PIXEL = {"mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2, "bgr8": 3, "8UC3": 3, "rgb8": 3}

_BAYER = "a Bayer image must be developed first (image_proc)"


def check_raw_image(
    encoding: str, width: int, height: int, step: int, size: int, max_pixels: int
) -> int:
    """Check that the numbers of a sensor_msgs/Image agree.

    Args:
        encoding: its encoding.
        width, height: px.
        step: bytes from row to row.
        size: bytes of data; the last row's padding may lack.
        max_pixels: largest number of pixels taken.

    Returns:
        Bytes of a pixel.

    Raises:
        ImageError: they don't, or the encoding is not taken.
    """
    each = BYTES_PER_PIXEL.get(encoding)
    if each is None:
        hint = _BAYER if encoding.startswith("bayer") else "expected mono8, mono16, bgr8 or rgb8"
        raise ImageError(f"encoding {encoding[:40]!r} is not taken; {hint}", "encoding")
    check_image_size(width, height, max_pixels)
    row = width * each
    if step < row:
        raise ImageError(
            f"step is {step}, expected at least {row} for {width} px of {encoding}", "step"
        )
    if size not in {step * height, step * (height - 1) + row}:
        raise ImageError(
            f"{size} bytes of data, expected {step * height} ({height} rows of {step} bytes)",
            "data",
        )
    return each


def check_image_size(width: int, height: int, max_pixels: int) -> None:
    """Check the size of an image, px.

    Raises:
        ImageError: it is empty or too large.
    """
    if width <= 0 or height <= 0:
        raise ImageError(f"image is {width} x {height}, expected both above 0", "width")
    if width * height > max_pixels:
        raise ImageError(
            f"image is {width} x {height}, expected at most {max_pixels} px (image.max_pixels)",
            "width",
        )


def check_calibrated_size(image: NDArray[Any], width: int, height: int) -> None:
    """Check that an image has the size of its calibration.

    Raises:
        ImageError: it has not.
    """
    if image.shape != (height, width):
        raise ImageError(
            f"image is {image.shape[1]} x {image.shape[0]}, "
            f"expected {width} x {height} as the camera info says",
            "width",
        )


def check_camera_info(info: Any, name: str) -> None:
    """Check the numbers of a sensor_msgs/CameraInfo; K, D and R may be missing.

    Args:
        info: the message; K, D, R and P may be in capitals, as ROS 1 has them.
        name: what to call it in an error.

    Raises:
        CalibrationError: a number is not finite, P is missing, the size is not above 0, or the
            region of interest is not a part of it.
    """
    for key in ("p", "k", "d", "r"):
        values = matrix_of(info, key)
        if key == "p" and values.size != 12:
            raise CalibrationError(
                f"{name}: P has {values.size} numbers, expected 12; calibrate the camera"
            )
        if not np.isfinite(values).all():
            raise CalibrationError(
                f"{name}: {key.upper()} has a number that is not finite; calibrate the camera"
            )
    full = int(info.width), int(info.height)
    if min(full) <= 0:
        raise CalibrationError(
            f"{name}: image size is {full[0]} x {full[1]}, expected both above 0; "
            "calibrate the camera"
        )
    x, y, width, height = region_of(info)
    width, height = width or full[0], height or full[1]
    if min(x, y, width, height) < 0 or x + width > full[0] or y + height > full[1]:
        raise CalibrationError(
            f"{name}: roi is {width} x {height} at ({x}, {y}), expected a part of the "
            f"{full[0]} x {full[1]} px of the camera; correct the driver's roi"
        )


def check_pose(message: Any) -> None:
    """Check PoseStamped, PoseWithCovarianceStamped or Odometry.

    Raises:
        MessageError: the stamp, a number, the quaternion or the pose's covariance is impossible.
    """
    check_stamp(message.header)
    pose, field = message.pose, "pose"
    if hasattr(pose, "covariance"):
        check_covariance("pose.covariance", pose.covariance, 6)
        pose, field = pose.pose, "pose.pose"
    check_point(f"{field}.position", pose.position)
    check_quaternion(f"{field}.orientation", pose.orientation)
    if hasattr(message, "twist"):
        check_finite(message)


def check_transform(message: Any) -> None:
    """Check geometry_msgs/TransformStamped; a static one needs no stamp.

    Raises:
        MessageError: a number or the quaternion is impossible.
    """
    check_point("transform.translation", message.transform.translation)
    check_quaternion("transform.rotation", message.transform.rotation)


def check_range(message: Any) -> None:
    """Check sensor_msgs/Range.

    An infinite range is no fault: nothing came back, or the bottom was too near (REP 117). Limits
    that are both 0 were not given.

    Raises:
        MessageError: the stamp or a number is impossible, or the range lies outside its limits.
    """
    check_stamp(message.header)
    # Older definitions of the message have no variance.
    variance = float(getattr(message, "variance", 0.0))
    angle = float(message.field_of_view)
    low, high = float(message.min_range), float(message.max_range)
    if not 0.0 <= variance < math.inf:
        raise refuse("variance", variance, "a finite number, at least 0")
    if not 0.0 <= angle < math.pi:
        raise refuse("field_of_view", angle, "0 to below 3.1416 rad")
    if not 0.0 <= low <= high < math.inf:
        raise refuse("min_range, max_range", (low, high), "0 <= min_range <= max_range")
    distance = float(message.range)
    if math.isinf(distance):
        return
    if not distance > 0.0:
        raise refuse("range", distance, "above 0 m")
    if high > 0.0 and not low <= distance <= high:
        raise refuse("range", distance, f"{low:g} to {high:g} m (min_range, max_range)")


def matrix_of(info: Any, key: str) -> Array:
    """Return a matrix of a CameraInfo, flat; empty where it is missing."""
    # ROS 1 bags write the matrices in capitals.
    values = getattr(info, key) if hasattr(info, key) else getattr(info, key.upper(), ())
    return np.array(values, dtype=np.float64).ravel()


def region_of(info: Any) -> tuple[int, int, int, int]:
    """Return x, y, width and height of a CameraInfo's region; 0 where nothing is said."""
    roi = getattr(info, "roi", None)
    x, y, width, height = (
        int(getattr(roi, key, 0)) for key in ("x_offset", "y_offset", "width", "height")
    )
    return x, y, width, height
