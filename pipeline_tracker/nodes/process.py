"""What a live process needs before ROS is there: environment, signals, words to the user."""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
from enum import Enum
from importlib import import_module

from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.nodes.left_memory import remove_left_segments
from pipeline_tracker.resources import config_path

# A node whose standard input is a pipe from `run` ends with it.
CHILD_VARIABLE = "PIPELINE_TRACKER_CHILD"
# Where it is set, our nodes log what becomes of each frame; DDS and rclpy do not.
DEBUG_VARIABLE = "PIPELINE_TRACKER_DEBUG"


class Log(Enum):
    """How much the nodes write to their log."""

    ERRORS = "errors"
    USUAL = "usual"
    DEBUG = "debug"


class RosMissingError(PipelineTrackerError):
    """A live command is used where ROS 2 is not installed."""


def require_ros(command: str) -> None:
    """Check that rclpy and the compiled messages are there.

    Raises:
        RosMissingError: they are not.
    """
    try:
        import_module("rclpy")
        # In a source tree the directory of the definitions has the name of the compiled package.
        if not hasattr(import_module("pipeline_tracker_msgs.msg"), "RelativeState"):
            raise ModuleNotFoundError(name="pipeline_tracker_msgs")
    except ImportError as error:
        raise RosMissingError(
            f"{command} needs ROS 2 with Python ({error.name or error} is missing); install "
            "pipeline_tracker on Linux x86-64 with pip, or build it with colcon where ROS 2 Jazzy "
            "is installed; replay works without"
        ) from None


def prepare_transport(*, local: bool) -> None:
    """Set up DDS before rclpy starts: by the environment, where what the user has set is kept.

    Shared memory of processes that were killed is taken back.

    Args:
        local: discover nodes on this computer only.
    """
    # Fast DDS's default shared-memory segment of 512 kB is smaller than an image: best-effort
    # images between two processes get lost. The segment is that of the publisher.
    if "FASTDDS_DEFAULT_PROFILES_FILE" not in os.environ:
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_path("fastdds.xml")))
    if local and "ROS_LOCALHOST_ONLY" not in os.environ:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    remove_left_segments()


class Stop:
    """What ends a process: a signal, or its own work."""

    def __init__(self) -> None:
        """Wait for nothing yet."""
        # SimpleQueue.put may be called from a signal handler at any moment, unlike Event.set.
        self._reasons: queue.SimpleQueue[int] = queue.SimpleQueue()

    def on_signals(self, code: int) -> None:
        """Make SIGINT and SIGTERM end the process with an exit code; in the main thread only."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self._reasons.put(code))

    def end(self, code: int) -> None:
        """End the process with an exit code."""
        self._reasons.put(code)

    def wait(self, seconds: float | None = None) -> int | None:
        """Wait for the end; return the exit code, or None where it has not come in time."""
        try:
            if seconds is not None and seconds <= 0.0:
                return self._reasons.get_nowait()
            return self._reasons.get(timeout=seconds)
        except queue.Empty:
            return None


def say(text: str, *, error: bool = False) -> None:
    """Write a line for the user, to standard output or standard error."""
    stream = sys.stderr if error else sys.stdout
    stream.write(f"{text}\n")
    stream.flush()
