"""ROS 2: libraries, messages, middleware, shared memory, and whether nodes find each other."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from pipeline_tracker.doctor.finding import Finding
from pipeline_tracker.nodes.left_memory import SHARED_MEMORY, left_segments
from pipeline_tracker.nodes.process import RosMissingError, prepare_transport, require_ros

_DISTRIBUTION = "jazzy"
_MIDDLEWARE = "rmw_fastrtps_cpp"
# Each participant has a segment of 32 MiB (config/fastdds.xml); five of them, and a camera's.
_LEAST_SHARED = 256e6
_PROBE_WITHIN = 60.0
# Above 101, Linux gives the ports to others.
_HIGHEST_DOMAIN = 101
_WITHOUT_ROS = "Offline commands (replay, evaluate, report and so on) work without"


def installation() -> Iterator[Finding]:
    """Look at rclpy, the messages and the distribution of ROS."""
    try:
        require_ros("run")
    except RosMissingError as error:
        yield Finding("look", "ROS 2", str(error), _WITHOUT_ROS)
        return
    place = Path(str(import_module("rclpy").__file__)).parent
    yield Finding("ok", "ROS 2", f"rclpy in {place}")
    distribution = os.environ.get("ROS_DISTRO")
    if distribution not in {None, _DISTRIBUTION}:
        yield Finding(
            "look",
            "distribution",
            f"ROS_DISTRO is {distribution}",
            "Tested is Jazzy; messages of other distributions may differ",
        )
    if find_spec("tf2_msgs") is None:
        yield Finding(
            "look",
            "tf2_msgs",
            "not installed: live, /tf_static cannot be read",
            "Give camera.translation and camera.rotation_rpy to `run`",
        )


def middleware(environment: Mapping[str, str] = os.environ) -> Iterator[Finding]:
    """Look at what moves the messages, and at the variables that steer it.

    Args:
        environment: variables; those of the process by default.
    """
    chosen = environment.get("RMW_IMPLEMENTATION", _MIDDLEWARE)
    if find_spec("rclpy") is not None:
        try:
            name = import_module("rclpy.utilities").get_rmw_implementation_identifier()
        except Exception as error:  # noqa: BLE001 - the library may not load
            yield Finding(
                "wrong",
                "middleware",
                f"{chosen} cannot be loaded ({' '.join(str(error).split())[:200]})",
                f"Install it, or unset RMW_IMPLEMENTATION; tested is {_MIDDLEWARE}",
            )
        else:
            known = name == _MIDDLEWARE
            advice = "" if known else f"Tested is {_MIDDLEWARE}: set RMW_IMPLEMENTATION to it"
            yield Finding("ok" if known else "look", "middleware", name, advice)
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        file = environment.get(variable)
        if file and not Path(file).is_file():
            yield Finding(
                "wrong", variable, f"{file}: no such file", "Name an existing file, or unset it"
            )
    yield from _domain(environment)


def _domain(environment: Mapping[str, str]) -> Iterator[Finding]:
    domain = environment.get("ROS_DOMAIN_ID", "0")
    if not domain.isdecimal() or int(domain) > _HIGHEST_DOMAIN:
        yield Finding(
            "wrong",
            "ROS_DOMAIN_ID",
            domain,
            f"Expected 0 to {_HIGHEST_DOMAIN}, the same on all machines of the vehicle",
        )
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
    if "ROS_LOCALHOST_ONLY" in environment:
        yield Finding(
            "look",
            "discovery",
            f"ROS_LOCALHOST_ONLY={environment['ROS_LOCALHOST_ONLY']}",
            "Deprecated in Jazzy: set ROS_AUTOMATIC_DISCOVERY_RANGE in its place",
        )
    elif reach is None:
        yield Finding(
            "ok",
            "discovery",
            "`run` finds nodes of this machine only",
            "Cameras on another machine: ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET",
        )
    elif reach == "OFF":
        yield Finding(
            "wrong",
            "discovery",
            "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes find nothing",
            "Set it to LOCALHOST or SUBNET",
        )
    else:
        yield Finding("ok", "discovery", f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}")


def shared_memory(place: Path = SHARED_MEMORY) -> Iterator[Finding]:
    """Look at the memory through which images go from one process to another.

    Args:
        place: its directory.
    """
    if sys.platform != "linux":
        return
    if not place.is_dir() or not os.access(place, os.W_OK):
        yield Finding(
            "wrong",
            "shared memory",
            f"{place} is not there, or cannot be written to",
            "In a container: --ipc=host, or --shm-size=512m",
        )
        return
    free = shutil.disk_usage(place).free
    enough = free >= _LEAST_SHARED
    yield Finding(
        "ok" if enough else "wrong",
        "shared memory",
        f"{free / 1e6:.0f} MB free in {place}",
        "" if enough else "256 MB are needed; in a container: --shm-size=512m",
    )
    left = left_segments(place)
    if left:
        size = sum(segment.stat().st_size for segment in left if segment.exists())
        yield Finding(
            "look",
            "shared memory",
            f"killed processes have left {len(left)} segments of Fast DDS, {size / 1e6:.0f} MB",
            "The next `run` takes them back",
        )


def conversation() -> Iterator[Finding]:
    """Let two processes find each other and pass images, as the nodes and a camera do."""
    if find_spec("rclpy") is None:
        return
    prepare_transport(local=True)
    command = [sys.executable, "-m", "pipeline_tracker.nodes.conversation"]
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, capture_output=True, text=True, timeout=_PROBE_WITHIN, check=False
        )
    except subprocess.TimeoutExpired:
        yield Finding(
            "wrong",
            "conversation",
            f"two processes did not talk within {_PROBE_WITHIN:g} s",
            "Look at ROS_DOMAIN_ID, firewall and loopback interface",
        )
        return
    lines = done.stdout.strip().splitlines()
    if done.returncode != 0 or not lines:
        last = (done.stderr.strip().splitlines() or ["no word of why"])[-1]
        yield Finding("wrong", "conversation", last[:200], "Look at the middleware first")
        return
    yield _heard(json.loads(lines[-1]))


def _heard(told: Mapping[str, float]) -> Finding:
    what = "conversation"
    if told["found_s"] < 0:
        return Finding(
            "wrong",
            what,
            "two processes on this machine do not find each other",
            "Is the loopback interface up (ip link show lo), does it take multicast, does a "
            "firewall block UDP 7400 to 7650?",
        )
    sent, received = int(told["sent"]), int(told["received"])
    seen = (
        f"two processes found each other in {told['found_s']:.1f} s, "
        f"{received} of {sent} images of 1 MB arrived, in {told['median_ms']:.1f} ms"
    )
    if received < sent:
        return Finding(
            "wrong" if received == 0 else "look",
            what,
            seen,
            "Images get lost: use config/fastdds.xml for the camera's process too "
            "(FASTRTPS_DEFAULT_PROFILES_FILE), and make room in shared memory",
        )
    return Finding("ok", what, seen)
