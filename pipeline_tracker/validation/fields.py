"""Fields that several messages have: stamps, numbers, points, quaternions, covariances."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import MessageError

# Farther from its frame's origin nothing is, m; beyond, sums of float64 lose millimetres.
FARTHEST = 1e9
FINITE = "a finite number"

_NORM_EXACT = 0.01
# A covariance is rounded where it was computed: shares of the product of two deviations.
_COVARIANCE_EXACT = 1e-6


def refuse(field: str, found: object, expected: str) -> MessageError:
    """Return the error for a field that cannot be used."""
    return MessageError(f"{field} is {_shown(found)}, expected {expected}", field)


def check_stamp(header: Any, field: str = "header.stamp") -> None:
    """Check the stamp of a std_msgs/Header: at or after 1970, with a whole second's part.

    Raises:
        MessageError: it is not.
    """
    sec, nanosec = int(header.stamp.sec), int(header.stamp.nanosec)
    if sec < 0:
        raise refuse(f"{field}.sec", sec, "at least 0")
    if not 0 <= nanosec < 1_000_000_000:
        raise refuse(f"{field}.nanosec", nanosec, "0 to 999999999")


def check_finite(message: Any) -> None:
    """Check that no number in a whole message is NaN or infinite.

    Raises:
        MessageError: one is; the first one is named.
    """
    for field, value in _numbers_of(message, ""):
        raise refuse(field, value, FINITE)


def check_point(field: str, point: Any) -> None:
    """Check geometry_msgs/Point or Vector3, m.

    Raises:
        MessageError: a number is not finite, or farther than anything is.
    """
    for axis in "xyz":
        value = float(getattr(point, axis))
        if not abs(value) <= FARTHEST:
            raise refuse(f"{field}.{axis}", value, f"a finite number within {FARTHEST:g} m")


def check_quaternion(field: str, quaternion: Any) -> None:
    """Check geometry_msgs/Quaternion.

    Raises:
        MessageError: its norm is further than 1 % from 1, or not a number.
    """
    values = [float(getattr(quaternion, axis)) for axis in "xyzw"]
    norm = math.sqrt(math.fsum(v * v for v in values)) if max(map(abs, values)) < 2.0 else math.inf
    if not abs(norm - 1.0) < _NORM_EXACT:
        raise refuse(field, values, f"a quaternion of norm 1, it has norm {norm:.4g}")


def check_covariance(field: str, values: Any, size: int) -> None:
    """Check a covariance: finite, symmetric, positive semidefinite, with a diagonal of 0 or more.

    Args:
        field: what to call it in an error.
        values: numbers, row by row.
        size: rows and columns expected.

    Raises:
        MessageError: it is none.
    """
    flat = np.array(values, dtype=np.float64).ravel()
    if flat.size != size * size:
        raise refuse(f"the length of {field}", flat.size, f"{size * size}")
    if not np.isfinite(flat).all():
        raise refuse(field, first_bad(flat), FINITE)
    if not flat.any():
        return
    matrix = flat.reshape(size, size)
    diagonal = np.diag(matrix)
    if (diagonal < 0.0).any():
        raise refuse(f"the diagonal of {field}", diagonal.tolist(), "numbers of at least 0")
    largest = np.sqrt(diagonal)[:, None] * np.sqrt(diagonal)
    # Written so that a deviation of 0 allows no correlation at all.
    wrong = np.abs(matrix) > largest * (1.0 + _COVARIANCE_EXACT)
    wrong |= np.abs(matrix - matrix.T) > largest * _COVARIANCE_EXACT
    if wrong.any():
        row, column = (int(index) for index in np.argwhere(wrong)[0])
        pair = [float(matrix[row, column]), float(matrix[column, row])]
        raise refuse(
            f"{field} at ({row}, {column}) and ({column}, {row})",
            pair,
            f"one number of at most {largest[row, column]:g}",
        )
    # In shares of the deviations: metres and radians are then of one size.
    shares = np.divide(matrix, largest, out=np.eye(size), where=largest > 0.0)
    least = float(np.linalg.eigvalsh(shares)[0])
    if not least >= -_COVARIANCE_EXACT * size:
        raise refuse(
            f"the least eigenvalue of {field}, scaled to a diagonal of 1,", least, "at least 0"
        )


def _numbers_of(message: Any, path: str) -> Iterator[tuple[str, float]]:
    """Yield every number of a message that is not finite, with its field."""
    for name in field_names(message):
        value = getattr(message, name)
        field = f"{path}{name}"
        if isinstance(value, float | np.floating):
            if not math.isfinite(value):
                yield field, float(value)
        elif isinstance(value, str | bytes | int | bool):
            continue
        elif isinstance(value, list | tuple) and value and field_names(value[0]):
            for index, item in enumerate(value):
                yield from _numbers_of(item, f"{field}[{index}].")
        elif field_names(value):
            yield from _numbers_of(value, f"{field}.")
        elif isinstance(value, Sequence | np.ndarray) or hasattr(value, "typecode"):
            numbers = np.asarray(value)
            if numbers.dtype.kind == "f" and not np.isfinite(numbers).all():
                yield field, first_bad(numbers)


def field_names(message: Any) -> Sequence[str]:
    """Return the names of a message's fields, in either world; empty for what is no message."""
    if hasattr(message, "get_fields_and_field_types"):
        # rclpy copies the dictionary at each call; the slots are there anyway.
        return [slot.removeprefix("_") for slot in message.__slots__ if slot != "_check_fields"]
    if not hasattr(message, "__msgtype__"):
        return ()
    # Constants, in capitals, are fields of rosbags' classes too.
    names = message.__dataclass_fields__
    return [name for name in names if not name.startswith("_") and not name.isupper()]


def first_bad(numbers: NDArray[Any]) -> float:
    """Return the first number that is not finite."""
    return float(numbers[~np.isfinite(numbers)].ravel()[0])


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_shown(v) for v in value)}]"
    return repr(value)[:60]
