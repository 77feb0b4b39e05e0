"""Image messages of one or two cameras to images of the rectified pair.

The one way into the pipeline, live and offline: decoding, the check of the size and, where the
images are not rectified (setting ``camera.rectify``), their rectification.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.camera_info import (
    RawCamera,
    camera_from_info,
    is_whole_sensor,
    raw_camera_from_info,
)
from pipeline_tracker.errors import CalibrationError, ImageError
from pipeline_tracker.geometry.camera import StereoRig, stereo_rig
from pipeline_tracker.geometry.unseen import Unseen, UnseenPair
from pipeline_tracker.images import decode_image
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import Image
from pipeline_tracker.validation.inputs import check_calibrated_size

_SIDES = ("left", "right")
# What OpenCV's maps can address.
_LONGEST_SIDE = 32_000
# A calibration that uses less of its own image is that of another camera.
_LEAST_SEEN = 0.25


class StereoImages:
    """Images of cameras with one calibration.

    Attributes:
        rig: the rectified cameras.
        unseen: what of their pictures the cameras have not seen.
        infos_hold: whether the camera infos, as they came, describe the images as they are read.
    """

    def __init__(
        self,
        settings: Settings,
        left_info: Any,
        right_info: Any = None,
        names: tuple[str, str] = ("left camera_info", "right camera_info"),
    ) -> None:
        """Take a calibration.

        Args:
            settings: ``camera.rectify`` and ``image.*``.
            left_info, right_info: sensor_msgs/CameraInfo; right None in mono.
            names: what to call the infos in an error.

        Raises:
            CalibrationError: the calibration is missing or impossible.
        """
        infos = [i for i in (left_info, right_info) if i is not None]
        named = list(zip(infos, names, strict=False))
        cameras = [camera_from_info(info, name=name) for info, name in named]
        self.rig: StereoRig = stereo_rig(cameras[0], cameras[1] if len(cameras) > 1 else None)
        self.unseen = UnseenPair()
        self.infos_hold = not settings.camera.rectify and all(is_whole_sensor(i) for i in infos)
        self._settings = settings.image
        self._maps: list[_Maps] = []
        if settings.camera.rectify:
            raw = [raw_camera_from_info(info, name=name) for info, name in named]
            for camera, name in zip(raw, names, strict=False):
                self._check_maps(camera, name)
            self._maps = [_maps(camera) for camera in raw]
            for maps, name in zip(self._maps, names, strict=False):
                _check_seen(maps, name)
            self.unseen = UnseenPair(*(maps.unseen for maps in self._maps))

    def read(self, message: Any, side: str) -> Image:
        """Decode an image message and rectify it where it needs that.

        Args:
            message: sensor_msgs/Image or sensor_msgs/CompressedImage.
            side: left or right.

        Returns:
            (H, W) uint8, contiguous.

        Raises:
            ImageError: it cannot be decoded, or has not the size of its calibration.
        """
        camera = self.rig.left
        try:
            image = decode_image(message, self._settings)
            check_calibrated_size(image, camera.width, camera.height)
        except ImageError as error:
            raise ImageError(f"{side} image: {error}", f"{side} image {error.field}") from None
        if not self._maps:
            return image
        maps = self._maps[_SIDES.index(side)]
        # Where nothing was seen the border goes on: the fewest edges that are not there.
        border = cv2.BORDER_REPLICATE
        made = cv2.remap(image, maps.places, maps.parts, cv2.INTER_CUBIC, borderMode=border)
        return np.asarray(made, np.uint8)

    def _check_maps(self, raw: RawCamera, name: str) -> None:
        width, height = raw.camera.width, raw.camera.height
        if width * height > self._settings.max_pixels or max(width, height) > _LONGEST_SIDE:
            raise CalibrationError(
                f"{name}: image size is {width} x {height}, expected at most "
                f"{self._settings.max_pixels} px (image.max_pixels) and {_LONGEST_SIDE} px a side; "
                "calibrate the camera"
            )


class _Maps(NamedTuple):
    """Where each pixel of a rectified picture comes from, as OpenCV's remap has it.

    Attributes:
        places: (H, W, 2) int16, whole pixels.
        parts: (H, W) uint16, number of the part of a pixel.
        unseen: what lies outside the image; None where nothing does.
    """

    places: NDArray[Any]
    parts: NDArray[Any]
    unseen: Unseen | None


# Camera infos come with every image and say the same; one pair of cameras is kept.
@lru_cache(maxsize=2)
def _maps(raw: RawCamera) -> _Maps:
    """Compute the maps of a camera; 10 bytes for each pixel are kept."""
    camera = raw.camera
    size = camera.width, camera.height
    k, r = (np.array(matrix).reshape(3, 3) for matrix in (raw.matrix, raw.rotation))
    d = np.array(raw.coefficients)
    make: Any = cv2.initUndistortRectifyMap
    if raw.model == "equidistant":
        make = cv2.fisheye.initUndistortRectifyMap
    x, y = make(k, d, r, camera.matrix, size, cv2.CV_32FC1)
    last_x, last_y = np.float32(camera.width - 1), np.float32(camera.height - 1)
    # Written so that NaN counts as unseen.
    unseen = ~((x >= 0) & (x <= last_x) & (y >= 0) & (y <= last_y))
    # The maps' numbers are small ones: far away means at the border.
    for axis, last in ((x, last_x), (y, last_y)):
        np.nan_to_num(axis, copy=False, nan=0.0)
        np.clip(axis, 0.0, last, out=axis)
    places, parts = cv2.convertMaps(x, y, cv2.CV_16SC2)
    return _Maps(np.asarray(places), np.asarray(parts), Unseen(unseen) if unseen.any() else None)


def _check_seen(maps: _Maps, name: str) -> None:
    if maps.unseen is None:
        return
    seen = 1.0 - float(maps.unseen.mask.mean())
    if seen < _LEAST_SEEN:
        raise CalibrationError(
            f"{name}: by K, D, R and P only {100 * seen:.0f} % of the rectified picture come from "
            f"the image, expected at least {100 * _LEAST_SEEN:.0f} %; calibrate the camera"
        )
