"""True contours of a frame: how much of them is hidden."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import EvaluationError

Array = NDArray[np.float64]

OUTSIDE, HIDDEN, VISIBLE = 0, 1, 2
# Of one contour's length in view at least this share is not hidden in a detectable frame.
DETECTABLE_SHARE = 0.25
_FLOAT32 = 7


def contours_from_message(message: Any, topic: str) -> tuple[Array, NDArray[np.int64]]:
    """Read a sensor_msgs/PointCloud2 of contours: a row for each side, float32 fields u, v, flag.

    Args:
        message: the message.
        topic: its topic, for errors.

    Returns:
        Pixels (sides, S, 2) and flags (sides, S): outside, hidden or visible.

    Raises:
        EvaluationError: it lacks a field, or its numbers do not agree.
    """
    offsets = {f.name: f.offset for f in message.fields if f.datatype == _FLOAT32}
    missing = [name for name in ("u", "v", "flag") if name not in offsets]
    if missing:
        raise EvaluationError(
            f"{topic}: the contours have no float32 field {missing[0]}, expected u, v and flag"
        )
    rows, columns, step = int(message.height), int(message.width), int(message.point_step)
    data = np.asarray(message.data, dtype=np.uint8)
    if message.row_step != columns * step or data.size != rows * columns * step:
        raise EvaluationError(
            f"{topic}: {data.size} bytes of contours, expected {rows} x {columns} x {step}"
        )
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": ["u", "v", "flag"],
            "formats": [f"{order}f4"] * 3,
            "offsets": [offsets[name] for name in ("u", "v", "flag")],
            "itemsize": step,
        }
    )
    points = data.view(kind).reshape(rows, columns)
    pixels = np.stack((points["u"], points["v"]), axis=-1).astype(np.float64)
    return pixels, points["flag"].astype(np.int64)


def is_detectable(pixels: Array, flags: NDArray[np.int64]) -> bool:
    """Return whether, of one contour's length in view, at least a quarter is not hidden.

    Args:
        pixels: contour points in order along the pipe, (sides, S, 2), px.
        flags: (sides, S), outside the image, hidden or visible.
    """
    for points, seen in zip(pixels, flags, strict=True):
        inside = (seen[:-1] != OUTSIDE) & (seen[1:] != OUTSIDE)
        lengths = np.linalg.norm(np.diff(points, axis=0)[inside], axis=1)
        # A piece between a visible and a hidden point is hidden for one half.
        shown = (seen == VISIBLE).astype(np.float64)
        visible = ((shown[:-1] + shown[1:]) / 2.0)[inside]
        if lengths.sum() > 0.0 and lengths @ visible >= DETECTABLE_SHARE * lengths.sum():
            return True
    return False
