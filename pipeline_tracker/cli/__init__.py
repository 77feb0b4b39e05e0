"""The command line: pipeline-tracker COMMAND ...

Each command reads its arguments and hands back what is to be done; ``main`` does it and turns the
outcome into an exit code: 0 done; 1 done, but the pipe was never found (or a run of a benchmark
failed); 2 wrong command or bad input, with one line on stderr; 130 interrupted.
"""

from pipeline_tracker.cli.app import app
from pipeline_tracker.cli.entry import _guard_ros_args, main, run_command

__all__ = ["_guard_ros_args", "app", "main", "run_command"]
