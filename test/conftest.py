"""Settings of the whole test run."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import rosbags.highlevel.anyreader
import rosbags.serde.cdr
from hypothesis import settings

import pipeline_tracker

ROOT = Path(__file__).resolve().parent.parent

# A busy machine is slow, not wrong. The same examples in each run: a test that passed passes again;
# PIPELINE_TRACKER_SEARCH=1 looks for new ones.
settings.register_profile(
    "pipeline_tracker", deadline=None, derandomize="PIPELINE_TRACKER_SEARCH" not in os.environ
)
settings.load_profile("pipeline_tracker")

# Tests talk over DDS and must not reach other machines; set before anything starts rclpy.
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

# A shell that runs the tests in the background has SIGINT ignored, and so would what they start and
# interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What tests start, wherever they start it, is what they import: one code, one cache of kernels.
if Path(pipeline_tracker.__file__).resolve().parent == ROOT / "pipeline_tracker":
    _PATH = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(ROOT) not in _PATH:
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), *_PATH]))

# For each bag that is opened rosbags parses the definitions of its messages and writes and compiles
# the code that reads them: a third of the time of the tests that read bags. The same text gives the
# same again.
if hasattr(rosbags.highlevel.anyreader, "get_types_from_msg"):
    rosbags.highlevel.anyreader.get_types_from_msg = functools.cache(
        rosbags.highlevel.anyreader.get_types_from_msg
    )
if hasattr(rosbags.serde.cdr, "compile_lines"):
    _compile_lines = rosbags.serde.cdr.compile_lines

    @functools.cache
    def _compile_text(text: str) -> object:
        return _compile_lines([text])

    rosbags.serde.cdr.compile_lines = lambda lines: _compile_text("\n".join(lines))

# All kernels, in two parts that are about as long.
_KERNELS = (
    """
from pipeline_tracker.pipeline import warm_up
warm_up()
""",
    """
import tempfile
from pathlib import Path
from pipeline_tracker.simulation import simulate
small = ["frames=1", "camera.width=96", "camera.height=64", "bed.resolution=0.1", "stretch=0"]
with tempfile.TemporaryDirectory() as directory:
    simulate("decoy", Path(directory) / "sea", small, progress=False)
""",
)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before workers do it, each for itself; they are kept on the disk."""
    if session.config.getoption("numprocesses", None):
        # What fails here, for want of an extra for example, is for the tests to tell.
        parts = [
            subprocess.Popen([sys.executable, "-c", part], stderr=subprocess.DEVNULL)
            for part in _KERNELS
        ]
        for part in parts:
            part.wait()


def _missing_for_ros() -> list[str]:
    # The definitions' directory has the name of the compiled package, but no origin.
    wanted = {name: find_spec(name) for name in ("rclpy", "pipeline_tracker_msgs")}
    return [name for name, spec in wanted.items() if spec is None or spec.origin is None]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip tests marked ``ros`` where ROS is missing, and say what is missing."""
    missing = _missing_for_ros()
    if missing:
        skip = pytest.mark.skip(reason=f"ROS 2 is not installed: no {' and no '.join(missing)}")
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(skip)
