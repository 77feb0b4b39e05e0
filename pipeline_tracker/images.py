"""Image messages to 8-bit grey, the same for replay and for live nodes.

Encodings: mono8, mono16, bgr8 and rgb8, raw or as JPEG or PNG. A mono16 pixel becomes
``value * 255 / white`` rounded down and cut at 255, with one ``white`` (setting
``image.mono16_white``) for all images: a scale taken from each image by itself would make the same
scene look different from frame to frame.
"""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import ImageError
from pipeline_tracker.settings import ImageSettings
from pipeline_tracker.types import Image
from pipeline_tracker.validation.inputs import check_image_size, check_raw_image

_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
# Start of frame of every JPEG process; C4, C8 and CC are other things.
_JPEG_SIZE_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def decode_image(message: Any, settings: ImageSettings) -> Image:
    """Decode sensor_msgs/Image or sensor_msgs/CompressedImage.

    Args:
        message: the message of either world, rosbags or rclpy.
        settings: white level and size limit.

    Returns:
        (H, W) uint8, contiguous.

    Raises:
        ImageError: the image is corrupt, too large, or of another encoding.
    """
    if hasattr(message, "format"):
        return decode_compressed(message.data, settings)
    return decode_raw(
        message.data,
        str(message.encoding),
        int(message.width),
        int(message.height),
        int(message.step),
        bool(message.is_bigendian),
        settings,
    )


def decode_raw(
    data: Any,
    encoding: str,
    width: int,
    height: int,
    step: int,
    is_bigendian: bool,
    settings: ImageSettings,
) -> Image:
    """Decode a raw image.

    Args:
        data: bytes, ``array.array`` or uint8 array.
        encoding: mono8, mono16, bgr8 or rgb8.
        width, height: size, px.
        step: bytes from row to row, padding included.
        is_bigendian: byte order of mono16.
        settings: white level and size limit.

    Returns:
        (H, W) uint8, contiguous.

    Raises:
        ImageError: another encoding, an empty or too large image, or numbers that do not agree.
    """
    flat = _as_bytes(data)
    size = check_raw_image(encoding, width, height, step, flat.size, settings.max_pixels)
    strides = (step, 1)
    rows = np.lib.stride_tricks.as_strided(flat, (height, width * size), strides, writeable=False)
    if size == 1:
        return np.ascontiguousarray(rows)
    rows = np.ascontiguousarray(rows)
    if size == 2:
        return _scale_mono16(rows.view(">u2" if is_bigendian else "<u2"), settings.mono16_white)
    code = cv2.COLOR_RGB2GRAY if encoding == "rgb8" else cv2.COLOR_BGR2GRAY
    return np.asarray(cv2.cvtColor(rows.reshape(height, width, 3), code), dtype=np.uint8)


def decode_compressed(data: Any, settings: ImageSettings) -> Image:
    """Decode a JPEG or PNG image.

    What kind it is, is read from the data itself; the size is read from the file's head and
    checked before anything is unpacked. A JPEG that breaks off is refused: the decoder would fill
    the rest with grey and say nothing.

    Args:
        data: bytes, ``array.array`` or uint8 array.
        settings: white level and size limit.

    Returns:
        (H, W) uint8, contiguous.

    Raises:
        ImageError: corrupt, too large, or neither JPEG nor PNG.
    """
    flat = _as_bytes(data)
    width, height = _compressed_size(flat.tobytes())
    check_image_size(width, height, settings.max_pixels)
    try:
        flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        pixels: NDArray[Any] | None = cv2.imdecode(flat, flags)
    except cv2.error as error:
        raise ImageError(f"compressed image is corrupt ({error.err})", "data") from None
    if pixels is None or pixels.shape != (height, width):
        raise ImageError("compressed image is corrupt, it cannot be unpacked", "data")
    if pixels.dtype == np.uint16:
        return _scale_mono16(pixels, settings.mono16_white)
    return np.ascontiguousarray(pixels, dtype=np.uint8)


def _scale_mono16(pixels: NDArray[Any], white: int) -> Image:
    scaled = pixels.astype(np.uint32) * 255 // white
    return np.minimum(scaled, 255).astype(np.uint8)


def _as_bytes(data: Any) -> NDArray[np.uint8]:
    if isinstance(data, np.ndarray):
        return data.view(np.uint8).ravel()
    return np.frombuffer(data, dtype=np.uint8)


def _compressed_size(raw: bytes) -> tuple[int, int]:
    """Read width and height from the head of a JPEG or PNG, and check that it does not break off.

    Raises:
        ImageError: neither JPEG nor PNG, or cut off.
    """
    if raw.startswith(_PNG_START):
        if len(raw) < 24 or _PNG_END not in raw[-64:]:
            raise ImageError(f"PNG image is cut off after {len(raw)} bytes", "data")
        width, height = struct.unpack(">II", raw[16:24])
        return width, height
    if raw.startswith(_JPEG_START):
        if not raw.rstrip(b"\x00").endswith(_JPEG_END):
            raise ImageError(f"JPEG image is cut off after {len(raw)} bytes", "data")
        return _jpeg_size(raw)
    head = raw[:8].hex(" ") or "nothing"
    raise ImageError(f"compressed image is neither JPEG nor PNG (it begins with {head})", "data")


def _jpeg_size(raw: bytes) -> tuple[int, int]:
    position = 2
    while position + 9 <= len(raw) and raw[position] == 0xFF:
        marker = raw[position + 1]
        if marker in _JPEG_SIZE_MARKERS:
            height, width = struct.unpack(">HH", raw[position + 5 : position + 9])
            return width, height
        # Fill bytes and markers that stand alone have no length.
        if marker == 0xFF:
            position += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:
            position += 2
        else:
            position += 2 + int.from_bytes(raw[position + 2 : position + 4], "big")
    raise ImageError("JPEG image is corrupt, its head does not say its size", "data")
