"""One process with one or more nodes: they are brought up, spun and ended in good order."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import rclpy
import rclpy.utilities
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.nodes.base import PipelineNode
from pipeline_tracker.nodes.lifecycle import in_words
from pipeline_tracker.nodes.process import CHILD_VARIABLE, DEBUG_VARIABLE, Stop

# After a signal everything ends within 2 s; this much of it is for our own threads.
END_WITHIN = 0.8


def run_nodes(
    kinds: Sequence[type[PipelineNode]],
    args: Sequence[str] | None = None,
    parameters: Mapping[str, Any] | None = None,
    stop: Stop | None = None,
    after: Callable[[], int] | None = None,
) -> NoReturn:
    """Run nodes in this process until SIGINT, SIGTERM or a node that cannot be configured.

    Args:
        kinds: the nodes' classes.
        args: command line with ``--ros-args``; None: that of the process.
        parameters: parameter values for all of them.
        stop: with signal handlers already installed; None: they are installed here.
        after: called when the nodes have ended; its exit code counts where theirs is 0.

    The process ends here, with exit code 0 after a signal, 2 after an error that the user can put
    right, 1 after another.
    """
    if stop is None:
        stop = Stop()
        stop.on_signals(0)
    end_with_parent(stop)
    # The main thread does nothing but wait: so it answers to a signal at any time, also while
    # kernels are compiled.
    session = _Session(kinds, args, parameters or {})
    thread = threading.Thread(target=session.run, args=(stop,), name="nodes", daemon=True)
    thread.start()
    code = stop.wait()
    session.end()
    thread.join(END_WITHIN)
    late = 0 if after is None else after()
    sys.stdout.flush()
    sys.stderr.flush()
    # A compiler or a kernel cannot be interrupted, and to end Python under it may crash. Where the
    # thread has ended nothing is left but Python itself, which takes half a second to end.
    os._exit(code or late)


class _Session:
    """The life of the nodes of a process, in a thread of its own."""

    def __init__(
        self,
        kinds: Sequence[type[PipelineNode]],
        args: Sequence[str] | None,
        parameters: Mapping[str, Any],
    ) -> None:
        self._kinds = kinds
        self._args = args
        self._parameters = parameters
        self._nodes: list[PipelineNode] = []
        self._executor: Any = None
        self._ended = threading.Event()

    def end(self) -> None:
        """Ask the thread to end."""
        self._ended.set()
        if self._executor is not None:
            # A task wakes the executor; its own `wake` alone lets it wait on.
            self._executor.create_task(lambda: None)

    def run(self, stop: Stop) -> None:
        """Live until ``end``, or until something fails."""
        code = 0
        try:
            args = None if self._args is None else list(self._args)
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            self._bring_up()
            while not self._ended.is_set():
                self._spin_once()
        except Exception as error:  # noqa: BLE001 - the process's last word
            code = self._report(error)
        finally:
            for node in self._nodes:
                node.close()
                node.destroy_node()
            if self._executor is not None:
                self._executor.shutdown(timeout_sec=0.0)
            rclpy.utilities.try_shutdown()
            stop.end(code)

    def _bring_up(self) -> None:
        for kind in self._kinds:
            self._nodes.append(kind(self._parameters))
            if DEBUG_VARIABLE in os.environ:
                self._nodes[-1].get_logger().set_level(LoggingSeverity.DEBUG)
        # All are configured before one is active: whoever waits for subscribers waits for all.
        started = [node for node in self._nodes if node.autostart]
        for node in started:
            _succeed(node, node.trigger_configure())
        executor = SingleThreadedExecutor()
        for node in self._nodes:
            executor.add_node(node)
        for node in started:
            _succeed(node, node.trigger_activate())
        self._executor = executor

    def _spin_once(self) -> None:
        try:
            self._executor.spin_once()
        except Exception as error:  # noqa: BLE001 - ROS's own callbacks must not end the node
            self._nodes[0].refused("executor", error)

    def _report(self, error: Exception) -> int:
        """Log the error in one line, unless its node has, and return the exit code."""
        if not any(node.failure is error for node in self._nodes):
            logger = self._nodes[-1].get_logger() if self._nodes else get_logger("pipeline_tracker")
            logger.fatal(in_words(error))
        return 2 if isinstance(error, PipelineTrackerError) else 1


def _succeed(node: PipelineNode, result: TransitionCallbackReturn) -> None:
    """Raise what a transition has failed of."""
    if result != TransitionCallbackReturn.SUCCESS:
        raise node.failure or RuntimeError("a transition failed")


def end_with_parent(stop: Stop) -> None:
    """In a child of `run`, end when the parent does, however it ends."""
    if CHILD_VARIABLE not in os.environ:
        return

    def watch() -> None:
        # Nothing is ever written: the read returns when the parent's end is closed.
        while os.read(0, 1):
            pass
        stop.end(0)

    threading.Thread(target=watch, name="parent-watch", daemon=True).start()
