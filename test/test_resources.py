"""Files that come with the package, in each kind of installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline_tracker.resources import (
    ResourceError,
    config_directory,
    config_path,
    message_directory,
)

ROOT = Path(__file__).resolve().parents[1]
MESSAGES = {"PipeSegment", "RelativeState", "TrackingStatus", "VectorizedStereo"}


def test_default_settings_are_found() -> None:
    assert config_path("default.yaml").read_text() == (ROOT / "config/default.yaml").read_text()
    assert config_path("default.yaml").parent == config_directory()


def test_message_definitions_are_found() -> None:
    assert {path.stem for path in message_directory().glob("*.msg")} == MESSAGES


def test_an_unknown_file_is_named_with_its_directory() -> None:
    with pytest.raises(ResourceError, match=r"no file nowhere\.yaml in .*config; expected one of"):
        config_path("nowhere.yaml")


def _copy_package(site: Path) -> Path:
    package = site / "pipeline_tracker"
    package.mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "resources.py"):
        shutil.copy(ROOT / "pipeline_tracker" / name, package)
    return package


def _ask(site: Path, ament_prefix_path: str = "") -> subprocess.CompletedProcess[str]:
    code = (
        "from pipeline_tracker.resources import config_path, message_directory;"
        "print(config_path('default.yaml')); print(message_directory())"
    )
    # -S: without the import hook of an editable install.
    environment = os.environ | {"PYTHONPATH": str(site), "AMENT_PREFIX_PATH": ament_prefix_path}
    return subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=site,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def _make_config(directory: Path) -> Path:
    directory.mkdir(parents=True)
    (directory / "default.yaml").touch()
    return directory


def test_wheel_layout(tmp_path: Path) -> None:
    package = _copy_package(tmp_path)
    config = _make_config(package / "config")
    (package / "msg").mkdir()
    answer = _ask(tmp_path).stdout.splitlines()
    assert answer == [str(config / "default.yaml"), str(package / "msg")]


def test_colcon_layout(tmp_path: Path) -> None:
    tracker, messages = tmp_path / "pipeline_tracker", tmp_path / "pipeline_tracker_msgs"
    site = tracker / "lib/python3/site-packages"
    _copy_package(site)
    config = _make_config(tracker / "share/pipeline_tracker/config")
    definitions = messages / "share/pipeline_tracker_msgs/msg"
    definitions.mkdir(parents=True)
    answer = _ask(site, os.pathsep.join([str(tracker), str(messages)])).stdout.splitlines()
    assert answer == [str(config / "default.yaml"), str(definitions)]


def test_symlinked_layout_leads_back_to_the_source_tree(tmp_path: Path) -> None:
    tree, site = tmp_path / "tree", tmp_path / "site"
    package = _copy_package(tree)
    (tree / "pyproject.toml").touch()
    config = _make_config(tree / "config")
    definitions = tree / "pipeline_tracker_msgs/msg"
    definitions.mkdir(parents=True)
    (site / "pipeline_tracker").mkdir(parents=True)
    for file in package.iterdir():
        (site / "pipeline_tracker" / file.name).symlink_to(file)
    answer = _ask(site).stdout.splitlines()
    assert answer == [str(config / "default.yaml"), str(definitions)]


def test_a_broken_installation_says_where_it_looked(tmp_path: Path) -> None:
    package = _copy_package(tmp_path)
    result = _ask(tmp_path)
    assert result.returncode == 1
    last = result.stderr.splitlines()[-1]
    assert "config of pipeline_tracker is missing (looked in " in last
    assert str(package / "config") in last
    assert "install pipeline_tracker again" in last
