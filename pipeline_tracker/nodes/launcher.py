"""`run`: the live nodes, all in one process or one process each."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml

from pipeline_tracker.nodes.process import (
    CHILD_VARIABLE,
    DEBUG_VARIABLE,
    Log,
    Stop,
    prepare_transport,
    require_ros,
    say,
)
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dotted_values, load_settings, read_qos_overrides

MODULES = ("stereo_vectorizer", "local_recognizer", "pipe_tracker", "relative_state_publisher")

# Children get this time to end after a signal, s; then they are killed.
_END_WITHIN = 1.7
# A child that has died is started again after this time, s.
_RESTART_AFTER = 1.0
_WATCH_EVERY = 0.1


@dataclass(frozen=True)
class Recording:
    """What `run` records.

    Attributes:
        directory: of the bag; it must not exist.
        images: record the images too.
    """

    directory: Path
    images: bool = False


def run(
    config: Path | None,
    overrides: list[str],
    separate: bool,
    ros_args: Sequence[str] = (),
    recording: Recording | None = None,
    log: Log = Log.USUAL,
    tell: Callable[[Settings], None] | None = None,
) -> int:
    """Run the four live nodes until SIGINT or SIGTERM.

    Args:
        config: settings file, or ROS parameter file; None: defaults.
        overrides: ``key=value`` each.
        separate: one process for each node, instead of one for all.
        ros_args: what follows ``--ros-args``: remappings, namespace, QoS override parameters.
        recording: what to record; None: nothing.
        log: how much the nodes write to their log.
        tell: called with the settings in force, before the nodes start.

    Returns:
        Exit code: 0 after a signal, 2 where a node cannot be configured, 1 after another error, or
        where the recording failed.

    Raises:
        PipelineTrackerError: a setting or the camera's mounting is missing or impossible, ROS is
            not installed, or the recording cannot be begun.
    """
    stop = Stop()
    stop.on_signals(0)
    require_ros("run")
    settings = load_settings(config, overrides)
    if tell is not None:
        tell(settings)
    prepare_transport(local=True)
    # Only here: rclpy need not be there to say that it is missing.
    import_module("pipeline_tracker.nodes.mounting").mounting_of_settings(settings)
    values = node_parameters(settings, config)
    if log is Log.DEBUG:
        os.environ[DEBUG_VARIABLE] = "1"
    # What the user says of it comes later, and wins.
    given = [*(["--log-level", "error"] if log is Log.ERRORS else []), *ros_args]
    args = ["--ros-args", *given] if given else []
    end = (
        None
        if recording is None
        else _begin_to_record(recording, settings, args, quiet=log is Log.ERRORS)
    )
    if separate:
        code = _run_separately(values, args, stop)
        late = 0 if end is None else end()
        return code or late
    return int(import_module("pipeline_tracker.nodes.live").run_all(args, values, stop, end))


def _begin_to_record(
    recording: Recording, settings: Settings, args: list[str], *, quiet: bool
) -> Callable[[], int]:
    """Start the recording process; return what ends it and gives its exit code."""
    # Only here: it brings what a run without a recording does not need.
    recorder = import_module("pipeline_tracker.nodes.recorder_process")
    recorder.check_directory(recording.directory)
    topics = recorder.recorded_topics(settings, images=recording.images)
    process = recorder.RecorderProcess(recording.directory, topics, args, quiet=quiet)
    end: Callable[[], int] = process.end
    return end


def node_parameters(settings: Settings, config: Path | None = None) -> dict[str, Any]:
    """Return the parameters of every node: all settings, and ROS's own from a parameter file.

    Args:
        settings: checked settings.
        config: the file that they come from; its ``qos_overrides`` are passed on.

    Raises:
        SettingsError: see ``read_qos_overrides``.
    """
    values = {k: v for k, v in dotted_values(settings).items() if v is not None}
    if config is not None:
        values.update(read_qos_overrides(config))
    return values


def _run_separately(values: dict[str, Any], args: list[str], stop: Stop) -> int:
    """Run one child for each node and watch over them."""
    with tempfile.TemporaryDirectory(prefix="pipeline_tracker_") as directory:
        file = Path(directory) / "parameters.yaml"
        document = {"/**": {"ros__parameters": values}}
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        given = [*(args or ["--ros-args"]), "--params-file", str(file)]
        children = _Children(given)
        try:
            for module in MODULES:
                children.start(module)
            while (code := stop.wait(_WATCH_EVERY)) is None:
                refused = children.look_after()
                if refused is not None:
                    return refused
            return code
        finally:
            children.end()


class _Children:
    """The nodes' processes; none of them outlives this one, however it ends."""

    def __init__(self, args: list[str]) -> None:
        self._args = args
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._died: dict[str, float] = {}

    def start(self, module: str) -> None:
        """Start a node's process."""
        command = [sys.executable, "-m", f"pipeline_tracker.nodes.{module}", *self._args]
        # A session of its own: Ctrl-C reaches this process alone, which passes it on. The pipe to
        # its standard input is never written to; it closes when this process ends.
        self._running[module] = subprocess.Popen(  # noqa: S603 - our own modules
            command,
            stdin=subprocess.PIPE,
            env={**os.environ, CHILD_VARIABLE: "1"},
            start_new_session=True,
        )

    def look_after(self) -> int | None:
        """Start again what has died; return 2 where a node cannot be configured."""
        for module, child in list(self._running.items()):
            code = child.poll()
            if code is None:
                continue
            if code == 2:
                return 2
            self._close_input(child)
            del self._running[module]
            self._died[module] = time.monotonic()
            say(f"{module} ended with exit code {code}; it is started again", error=True)
        for module, when in list(self._died.items()):
            if time.monotonic() - when >= _RESTART_AFTER:
                del self._died[module]
                self.start(module)
        return None

    def end(self) -> None:
        """End all children, by force those that take too long."""
        for child in self._running.values():
            child.terminate()
        deadline = time.monotonic() + _END_WITHIN
        for child in self._running.values():
            try:
                child.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            self._close_input(child)

    @staticmethod
    def _close_input(child: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(OSError):
            if child.stdin is not None:
                child.stdin.close()
