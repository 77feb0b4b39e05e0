"""The messages of ``pipeline_tracker_msgs``, and what leaves our nodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.validation.fields import (
    FARTHEST,
    FINITE,
    check_covariance,
    check_finite,
    check_point,
    check_stamp,
    first_bad,
    refuse,
)

# Segments and matches are at least so many pixels of the image each.
_PIXELS_FOR_EACH = 16
_LONGEST_REASON = 1000


def check_vectorized(message: Any) -> None:
    """Check pipeline_tracker_msgs/VectorizedStereo; ``check_camera_info`` checks its infos.

    Raises:
        MessageError: an array's length or a number is impossible.
    """
    check_stamp(message.header)
    width, height = int(message.left_info.width), int(message.left_info.height)
    mono = int(message.right_info.width) == 0
    for name in ("left_segments", "right_segments", "matches"):
        rows = _rows_of_four(name, getattr(message, name))
        most = 0 if mono and name != "left_segments" else width * height // _PIXELS_FOR_EACH
        if len(rows) > most:
            raise refuse(f"the number of {name}", len(rows), f"at most {most}")
        _check_pixels(name, rows, width, height)
    pixels = (height // 8) * (width // 8)
    for name, wanted in (("left_thumbnail", pixels), ("right_thumbnail", 0 if mono else pixels)):
        if len(getattr(message, name)) != wanted:
            found = len(getattr(message, name))
            raise refuse(f"the length of {name}", found, f"{wanted} for {width} x {height} px")
    _check_seconds("processing_time", message.processing_time)


def check_segment(message: Any) -> None:
    """Check pipeline_tracker_msgs/PipeSegment.

    Raises:
        MessageError: an unknown mode, technique or contour, contours that do not match the bits, or
            an impossible number.
    """
    check_stamp(message.header)
    _check_choice("mode", message.mode, 1)
    _check_choice("technique", message.technique, 4)
    check_point("start", message.start)
    check_point("end", message.end)
    if not 0.0 < float(message.radius) < FARTHEST:
        raise refuse("radius", float(message.radius), "above 0 m")
    check_covariance("covariance", message.covariance, 4)
    _check_share("support", message.support)
    _check_choice("visible_contours", message.visible_contours, 15)
    rows = _rows_of_four("contours", message.contours)
    wanted = int(message.visible_contours).bit_count()
    if len(rows) != wanted:
        bits = f"{wanted}, one for each bit of visible_contours={int(message.visible_contours)}"
        raise refuse("the number of contours", len(rows), bits)
    if not np.isfinite(rows).all():
        raise refuse("contours", first_bad(rows), FINITE)


def check_status(message: Any) -> None:
    """Check pipeline_tracker_msgs/TrackingStatus.

    Raises:
        MessageError: an unknown state, or an impossible number.
    """
    check_stamp(message.header)
    _check_choice("state", message.state, 2)
    if len(message.reason) > _LONGEST_REASON:
        raise refuse(
            "the length of reason", len(message.reason), f"at most {_LONGEST_REASON} characters"
        )
    _check_share("support", message.support)
    _check_known("seconds_since_seen", message.seconds_since_seen)
    _check_seconds("processing_time", message.processing_time)


def check_relative_state(message: Any) -> None:
    """Check pipeline_tracker_msgs/RelativeState.

    Raises:
        MessageError: an unknown side, or an impossible number.
    """
    check_stamp(message.header)
    check_finite(message)
    _check_choice("side", message.side, 3)
    _check_share("quality", message.quality)
    for name in ("heading_variance", "pitch_variance", "distance_variance", "speed_variance"):
        _check_known(name, getattr(message, name))


_OUTPUTS: dict[str, Callable[[Any], None]] = {
    "pipeline_tracker_msgs/msg/VectorizedStereo": check_vectorized,
    "pipeline_tracker_msgs/msg/PipeSegment": check_segment,
    "pipeline_tracker_msgs/msg/TrackingStatus": check_status,
    "pipeline_tracker_msgs/msg/RelativeState": check_relative_state,
}


def check_output(type_name: str, message: Any) -> None:
    """Check a message of ours before it is published: no NaN or infinity ever leaves.

    Args:
        type_name: ``package/msg/Name``.
        message: of this type.

    Raises:
        MessageError: it must not be published.
    """
    _OUTPUTS.get(type_name, check_finite)(message)


def _rows_of_four(name: str, values: Any) -> NDArray[np.float32]:
    flat = np.asarray(values, dtype=np.float32).ravel()
    if flat.size % 4:
        raise refuse(f"the length of {name}", flat.size, "a multiple of 4 (x1 y1 x2 y2 each)")
    return flat.reshape(-1, 4)


def _check_pixels(name: str, rows: NDArray[np.float32], width: int, height: int) -> None:
    """Check that pixels lie in the image, or beside it by no more than its own size."""
    x, y = rows[:, ::2], rows[:, 1::2]
    for values, size in ((x, width), (y, height)):
        # Written so that NaN is refused.
        bad = ~((values >= -size) & (values <= 2 * size))
        if bad.any():
            expected = f"pixels of an image of {width} x {height}"
            raise refuse(name, float(values[bad][0]), expected)


def _check_choice(field: str, value: Any, most: int) -> None:
    if not 0 <= int(value) <= most:
        raise refuse(field, int(value), f"0 to {most}")


def _check_share(field: str, value: Any) -> None:
    # float32 of 1 is 1, but of a sum it may be a little more.
    if not 0.0 <= float(value) <= 1.0 + 1e-6:
        raise refuse(field, float(value), "0 to 1")


def _check_seconds(field: str, value: Any) -> None:
    if not 0.0 <= float(value) < math.inf:
        raise refuse(field, float(value), "a finite number of at least 0 s")


def _check_known(field: str, value: Any) -> None:
    """Check a number that is at least 0, or -1 where it is not known."""
    number = float(value)
    if not (0.0 <= number < math.inf or number == -1.0):
        raise refuse(field, number, "at least 0, or -1 where it is not known")
