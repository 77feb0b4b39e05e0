"""`play`: a recorded bag on the live topics, with /clock."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import SettingsError
from pipeline_tracker.nodes.process import Stop, prepare_transport, require_ros

INTERRUPTED = 130


def play(
    bag: Path,
    rate: float = 1.0,
    loop: bool = False,
    ros_args: Sequence[str] = (),
    *,
    quiet: bool = False,
) -> int:
    """Publish a bag on the live topics, at the pace at which it was recorded.

    Args:
        bag: directory or file.
        rate: how many times as fast.
        loop: begin again at the end; time then jumps back.
        ros_args: what follows ``--ros-args``: remappings and namespace.
        quiet: say nothing but errors.

    Returns:
        Exit code: 0 at the end of the bag, 130 after a signal.

    Raises:
        PipelineTrackerError: the bag cannot be read, the rate is impossible, or ROS is not
            installed.
    """
    if not 0.0 < rate < float("inf"):
        raise SettingsError(f"--rate {rate:g}: expected a number above 0, for example 1.0")
    stop = Stop()
    stop.on_signals(INTERRUPTED)
    with BagReader(bag) as reader:
        require_ros("play")
        prepare_transport(local=True)
        # Only here: rclpy need not be there to say that it is missing.
        bag_player = import_module("pipeline_tracker.nodes.bag_player")
        given = [*(["--log-level", "error"] if quiet else []), *ros_args]
        args = ["--ros-args", *given] if given else []
        return int(bag_player.play(reader, rate, loop=loop, args=args, stop=stop, quiet=quiet))
