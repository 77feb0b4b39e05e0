"""Where rclpy's messages and the core's types meet."""

from __future__ import annotations

from array import array
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CODES = {np.dtype(np.float32): "f", np.dtype(np.float64): "d", np.dtype(np.uint8): "B"}


@cache
def message_class(type_name: str) -> Any:
    """Return rclpy's class of ``package/msg/Name``.

    Raises:
        ImportError: its Python package is not installed, or has no such message.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except AttributeError:
        raise ImportError(f"{package} has no message {name}") from None


class LiveMessages:
    """Makes rclpy's messages; a ``pipeline_tracker.messages.MessageFactory``."""

    def message(self, type_name: str, /, **fields: Any) -> Any:
        """Return a message; fields left out have ROS's defaults."""
        return message_class(type_name)(**fields)

    def sequence(self, values: NDArray[Any], /) -> Any:
        """Return a one-dimensional array as rclpy takes it without looking at each element."""
        return array(_CODES[values.dtype], values.tobytes())
