"""True contours of a frame: where they are, and how much of them is hidden."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import EvaluationError

Array = NDArray[np.float64]

OUTSIDE, HIDDEN, VISIBLE = 0, 1, 2
# Of one contour's length in view at least this share is not hidden in a detectable frame.
DETECTABLE_SHARE = 0.25
_FLOAT32 = 7


@dataclass(frozen=True)
class TrueContours:
    """The true contours in one image.

    Attributes:
        pixels: in order along the pipe, (2, S, 2), px, side 0 left of the direction in which the
            axis is listed; NaN where there is none.
        flags: (2, S) OUTSIDE the image, HIDDEN by something before it, or VISIBLE.
        hidden_known: False where the contours were computed from the axis alone: what is VISIBLE
            is inside the image and may be hidden.
    """

    pixels: Array
    flags: NDArray[np.int64]
    hidden_known: bool = True


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
    shares = (visible_share(*side) for side in zip(pixels, flags, strict=True))
    return any(share is not None and share >= DETECTABLE_SHARE for share in shares)


def visible_share(points: Array, seen: NDArray[np.int64]) -> float | None:
    """Return which share of a contour's length in view is not hidden; None without any in view.

    Args:
        points: the contour in order along the pipe, (S, 2), px.
        seen: its flags, (S,).
    """
    inside = (seen[:-1] != OUTSIDE) & (seen[1:] != OUTSIDE)
    lengths = np.linalg.norm(np.diff(points, axis=0)[inside], axis=1)
    if not lengths.sum() > 0.0:
        return None
    # A piece between a visible and a hidden point is hidden for one half.
    shown = (seen == VISIBLE).astype(np.float64)
    visible = ((shown[:-1] + shown[1:]) / 2.0)[inside]
    return float(lengths @ visible / lengths.sum())
