"""What is built and installed, and that its descriptions agree with each other."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import pipeline_tracker

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pipeline_tracker"
MESSAGES = ROOT / "pipeline_tracker_msgs"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]

# The contract: other software reads and writes these.
FIELDS = {
    "VectorizedStereo": """
        std_msgs/Header header
        sensor_msgs/CameraInfo left_info
        sensor_msgs/CameraInfo right_info
        float32[] left_segments
        float32[] right_segments
        float32[] matches
        uint8[] left_thumbnail
        uint8[] right_thumbnail
        float32 processing_time
    """,
    "PipeSegment": """
        uint8 MODE_RECOGNITION=0
        uint8 MODE_TRACKING=1
        uint8 LEFT_IMAGE_LEFT=1
        uint8 LEFT_IMAGE_RIGHT=2
        uint8 RIGHT_IMAGE_LEFT=4
        uint8 RIGHT_IMAGE_RIGHT=8
        std_msgs/Header header
        uint8 mode
        uint8 technique
        geometry_msgs/Point start
        geometry_msgs/Point end
        float64 radius
        float64[16] covariance
        float32 support
        uint8 visible_contours
        float32[] contours
    """,
    "TrackingStatus": """
        uint8 SEARCHING=0
        uint8 TRACKING=1
        uint8 COASTING=2
        std_msgs/Header header
        uint8 state
        string reason
        float32 support
        float64 seconds_since_seen
        uint32 reset_counter
        float32 processing_time
    """,
    "RelativeState": """
        uint8 ALONG=0
        uint8 LEFT_OF_PIPE=1
        uint8 RIGHT_OF_PIPE=2
        uint8 NOT_IN_VIEW=3
        std_msgs/Header header
        bool valid
        float32 quality
        uint32 reset_counter
        float64 heading_misalignment
        float64 pitch_misalignment
        float64 min_distance
        float64 min_distance_base
        float64 approach_speed
        float64 lateral_offset
        float64 vertical_offset
        uint8 side
        bool motion_observed
        geometry_msgs/Point upper_point
        geometry_msgs/Point upper_point_vertical
        float64 chainage
        float64 heading_variance
        float64 pitch_variance
        float64 distance_variance
        float64 speed_variance
    """,
}


def _definition(name: str) -> str:
    return (MESSAGES / "msg" / f"{name}.msg").read_text()


@pytest.mark.parametrize("name", FIELDS)
def test_message_fields_are_those_of_the_contract(name: str) -> None:
    lines = (line.partition("#")[0].strip() for line in _definition(name).splitlines())
    assert [line for line in lines if line] == [
        line.strip() for line in FIELDS[name].strip().splitlines()
    ]


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_is_explained(name: str) -> None:
    explained = False
    for line in _definition(name).splitlines():
        if not line.strip():
            explained = False
        elif "#" in line:
            explained = True
        else:
            is_constant = "=" in line
            assert explained or is_constant, f"{name}: no comment on: {line}"


def test_all_messages_are_built() -> None:
    listed = re.findall(r'"msg/(\w+)\.msg"', (MESSAGES / "CMakeLists.txt").read_text())
    assert sorted(listed) == sorted(path.stem for path in (MESSAGES / "msg").iterdir())
    assert sorted(listed) == sorted(FIELDS)


@pytest.mark.ros
@pytest.mark.parametrize("name", FIELDS)
def test_compiled_messages_are_those_of_the_definitions(name: str) -> None:
    import pipeline_tracker_msgs.msg as compiled

    store = get_typestore(Stores.ROS2_JAZZY)
    full_name = f"pipeline_tracker_msgs/msg/{name}"
    store.register(get_types_from_msg(_definition(name), full_name))
    assert list(getattr(compiled, name).get_fields_and_field_types()) == [
        field for field, _ in store.fielddefs[full_name][1]
    ]


@pytest.mark.ros
def test_share_directory_is_found_by_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    from ament_index_python import get_package_share_directory

    if "AMENT_PREFIX_PATH" not in os.environ:
        # The wheels do not set it.
        monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    for package in ("pipeline_tracker", "pipeline_tracker_msgs"):
        share = Path(get_package_share_directory(package))
        assert (share / "package.xml").is_file()
    tracker = Path(get_package_share_directory("pipeline_tracker"))
    assert (tracker / "config/default.yaml").is_file()
    assert (tracker / "launch/pipeline_tracker.launch.py").is_file()


def test_the_package_is_one_directory() -> None:
    # An editable install of files that lie elsewhere would put these places beside it.
    assert len(list(pipeline_tracker.__path__)) == 1


def test_one_version_everywhere() -> None:
    versions = {
        ET.parse(directory / "package.xml").findtext("version") for directory in (PACKAGE, MESSAGES)
    }
    assert versions == {PROJECT["version"]} == {pipeline_tracker.__version__}


def test_colcon_and_pip_have_the_same_executables() -> None:
    text = (PACKAGE / "CMakeLists.txt").read_text()
    built = dict(re.findall(r'^  "([\w-]+)=([\w.]+)"$', text, flags=re.MULTILINE))
    assert {name: f"{module}:main" for name, module in built.items()} == PROJECT["scripts"]


def _ros_packages_in_use() -> set[str]:
    found = set()
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        # Types are often named by a string and looked up: "std_msgs/msg/Header".
        found |= set(re.findall(r"\b(\w+)/msg/\w", text))
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.partition(".")[0])
    found = {name for name in found if name.endswith(("_msgs", "_interfaces")) or name == "rclpy"}
    # tf2_msgs is used where the full ROS 2 is installed, foxglove_msgs in bags alone.
    return found - {"pipeline_tracker_msgs", "tf2_msgs", "foxglove_msgs"}


def test_ros_packages_in_use_are_required() -> None:
    required = {Requirement(line).name for line in PROJECT["dependencies"]}
    described = {e.text for e in ET.parse(PACKAGE / "package.xml").iter("exec_depend")}
    in_use = _ros_packages_in_use()
    assert {"rclpy", "sensor_msgs", "std_msgs"} <= in_use
    for name in in_use:
        assert f"ros-jazzy-{name.replace('_', '-')}" in required
        assert name in described


@pytest.mark.parametrize(
    ("system", "machine", "has_ros"),
    [
        ("linux", "x86_64", True),
        ("linux", "aarch64", False),
        ("darwin", "arm64", False),
        ("darwin", "x86_64", False),
        ("win32", "AMD64", False),
    ],
)
def test_ros_is_required_only_where_it_has_wheels(system: str, machine: str, has_ros: bool) -> None:
    environment = {"sys_platform": system, "platform_machine": machine}
    for lines in (PROJECT["dependencies"], PYPROJECT["build-system"]["requires"]):
        chosen = [
            requirement.name
            for requirement in map(Requirement, lines)
            if requirement.marker is None or requirement.marker.evaluate(environment)
        ]
        assert any(name.startswith("ros-") for name in chosen) == has_ros
        assert chosen


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as it is built where ROS has no wheels."""
    if find_spec("scikit_build_core") is None:
        pytest.skip("scikit-build-core is not installed; the extra [test] has it")
    directory = tmp_path_factory.mktemp("wheel")
    command = ["-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", str(directory)]
    subprocess.run(
        [sys.executable, *command, str(ROOT)],
        env=os.environ | {"PIPELINE_TRACKER_OFFLINE": "1"},
        check=True,
        capture_output=True,
    )
    (path,) = directory.iterdir()
    return path


def test_wheel_without_ros_is_pure_and_holds_what_is_needed(wheel: Path) -> None:
    assert wheel.name == f"pipeline_tracker-{PROJECT['version']}-py3-none-any.whl"
    names = set(zipfile.ZipFile(wheel).namelist())
    for path in PACKAGE.rglob("*.py"):
        assert path.relative_to(ROOT).as_posix() in names
    for path in (ROOT / "config").rglob("*"):
        assert path.is_dir() or f"pipeline_tracker/{path.relative_to(ROOT).as_posix()}" in names
    for name in FIELDS:
        assert f"pipeline_tracker/msg/{name}.msg" in names
    tops = {name.partition("/")[0] for name in names}
    assert tops == {"pipeline_tracker", f"pipeline_tracker-{PROJECT['version']}.dist-info"}
    assert not [name for name in names if "test_" in name or "CMakeLists" in name]


def test_wheel_without_ros_finds_its_files(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    code = (
        "from pipeline_tracker.resources import config_path, message_directory;"
        "print(config_path('default.yaml')); print(message_directory())"
    )
    # -S: without the import hook of an editable install.
    output = subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    package = tmp_path / "pipeline_tracker"
    assert output.splitlines() == [str(package / "config/default.yaml"), str(package / "msg")]


def _configure(tmp_path: Path, *definitions: str, **environment: str) -> str:
    """Configure a project without content under the check of the build tools."""
    cmake = shutil.which("cmake")
    if cmake is None:
        pytest.skip("cmake is not installed")
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(nothing)\n"
    )
    check = ROOT / "cmake/check_build_tools.cmake"
    result = subprocess.run(
        [cmake, "-S", ".", "-B", "build", f"-DCMAKE_PROJECT_INCLUDE_BEFORE={check}", *definitions],
        cwd=tmp_path,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    return result.stdout + result.stderr


def test_a_build_without_compiler_says_what_to_install(tmp_path: Path) -> None:
    output = _configure(tmp_path, f"-DPython3_EXECUTABLE={sys.executable}", CXX="/nowhere/g++ -O2")
    assert "a compiler (looked for /nowhere/g++)" in output
    assert "sudo apt-get install g++ python3-dev" in output


def test_a_build_without_python_headers_says_what_to_install(tmp_path: Path) -> None:
    python = tmp_path / "python3"
    python.write_text("#!/bin/sh\necho /nowhere/include\n")
    python.chmod(0o755)
    output = _configure(tmp_path, f"-DPython3_EXECUTABLE={python}")
    assert "the C headers of Python (looked for /nowhere/include/Python.h)" in output
    assert "sudo apt-get install g++ python3-dev" in output
