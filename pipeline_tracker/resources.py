"""Where the files are that come with the package: settings, scenarios, message definitions."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from pipeline_tracker.errors import PipelineTrackerError

_PACKAGE = Path(__file__).parent
_DEMO = Path("bags") / "demo"


class ResourceError(PipelineTrackerError):
    """A file that comes with the package is not there."""


def config_directory() -> Path:
    """Return the directory of default settings and scenarios.

    It is found in an installed wheel, an editable install, a source tree and a colcon install.

    Raises:
        ResourceError: the installation is not whole.
    """
    return _directory("config", "config", "share/pipeline_tracker/config")


def message_directory() -> Path:
    """Return the directory of the ``.msg`` files of pipeline_tracker_msgs; found without ROS too.

    Raises:
        ResourceError: the installation is not whole.
    """
    return _directory("msg", "pipeline_tracker_msgs/msg", "share/pipeline_tracker_msgs/msg")


def demo_bag() -> Path:
    """Return ``bags/demo`` of the source tree, or of the working directory.

    A wheel does not carry it.

    Raises:
        ResourceError: it is in neither.
    """
    tree = Path(__file__).resolve().parents[1]
    looked = [Path.cwd() / _DEMO]
    if (tree / "pyproject.toml").is_file():
        looked.insert(0, tree / _DEMO)
    for place in looked:
        if place.is_dir():
            return place
    raise ResourceError(
        f"the demo bag is not installed (looked for {', '.join(map(str, looked))}); name a bag "
        "with --images, or work in a clone of pipeline_tracker"
    )


def config_path(name: str) -> Path:
    """Return a file of ``config_directory()``.

    Args:
        name: path below that directory, with forward slashes, such as ``default.yaml``.

    Raises:
        ResourceError: there is no such file.
    """
    path = config_directory() / name
    if not path.is_file():
        raise ResourceError(
            f"there is no file {name} in {path.parent}; expected one of those in it, "
            "or install pipeline_tracker again"
        )
    return path


def _directory(in_package: str, in_tree: str, in_prefix: str) -> Path:
    looked = list(_places(in_package, in_tree, in_prefix))
    for place in looked:
        if place.is_dir():
            return place
    raise ResourceError(
        f"{in_package} of pipeline_tracker is missing (looked in {', '.join(map(str, looked))}); "
        "install pipeline_tracker again"
    )


def _places(in_package: str, in_tree: str, in_prefix: str) -> Iterator[Path]:
    # A wheel carries the files inside the package.
    yield _PACKAGE / in_package
    # An editable install and colcon's --symlink-install lead back to the source tree.
    tree = Path(__file__).resolve().parents[1]
    if (tree / "pyproject.toml").is_file():
        yield tree / in_tree
    # A colcon install has them under the share directory of its prefix.
    for parent in _PACKAGE.parents:
        if (parent / "share").is_dir():
            yield parent / in_prefix
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(prefix) / in_prefix
