from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline_tracker.cli import run_command
from pipeline_tracker.doctor import command, ros, system
from pipeline_tracker.doctor.finding import Finding, examined


def levels(findings: Iterator[Finding]) -> dict[str, str]:
    return {finding.what: finding.level for finding in findings}


def advice(findings: Iterator[Finding]) -> str:
    return " ".join(finding.advice for finding in findings)


def test_this_environment_is_sound() -> None:
    assert "wrong" not in levels(system.python()).values()
    assert set(levels(system.libraries()).values()) == {"ok"}
    assert "wrong" not in levels(system.kernels()).values()


def test_an_old_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system.sys, "version_info", (3, 9, 2))
    assert levels(system.python())["Python"] == "look"


def test_a_library_that_does_not_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_LIBRARIES", ("numpy", "no_such_library"))
    found = levels(system.libraries())
    assert found["no_such_library"] == "wrong"
    assert found["libraries"] == "ok"


def test_two_builds_of_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("opencv-python", "opencv_contrib_python_headless", "opencvish", "numpy")
    builds = [SimpleNamespace(metadata={"Name": name}) for name in names]
    monkeypatch.setattr(system, "distributions", lambda: builds)
    found = next(f for f in system.libraries() if f.what == "OpenCV")
    assert found.level == "wrong"
    assert "opencv-python, opencv_contrib_python_headless" in found.seen
    assert "opencvish" not in found.seen
    assert "uninstall" in found.advice


def test_an_old_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    real = system.import_module

    def old(name: str) -> Any:
        return SimpleNamespace(__version__="3.2", imdecode=1) if name == "cv2" else real(name)

    monkeypatch.setattr(system, "import_module", old)
    found = next(f for f in system.libraries() if f.what == "OpenCV")
    assert (found.level, "createCLAHE, remap" in found.seen) == ("wrong", True)


def test_extras_that_are_missing_are_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_EXTRAS", {"sim": ("numpy",), "cluster": ("no_such_library",)})
    found = next(f for f in system.libraries() if f.what == "extras")
    assert (found.level, found.seen) == ("ok", "sim")
    assert "cluster" in found.advice


def test_kernels_that_are_not_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert levels(system.kernels()) == {"kernels": "wrong"}


def test_kernels_that_cannot_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(file / "cache"))
    assert levels(system.kernels()) == {"kernels": "look"}
    assert "NUMBA_CACHE_DIR" in advice(system.kernels())


def test_kernels_that_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    (tmp_path / "a.nbi").touch()
    assert [f.seen for f in system.kernels()] == [f"1 kept in {tmp_path}"]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="no affinity on this system")
def test_one_core_and_a_high_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system.os, "sched_getaffinity", lambda _: {3})
    monkeypatch.setattr(system.os, "getloadavg", lambda: (4.0, 1.0, 1.0))
    found = levels(system.processor())
    assert (found["processor"], found["load"]) == ("look", "look")


def test_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "_available_memory", lambda: 0.3e9)
    assert levels(system.processor())["memory"] == "look"


def test_without_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(command: str) -> None:
        raise ros.RosMissingError(f"{command} needs ROS 2")

    monkeypatch.setattr(ros, "require_ros", missing)
    assert levels(ros.installation()) == {"ROS 2": "look"}
    assert "replay" in advice(ros.installation())


@pytest.mark.parametrize(
    ("variables", "what", "level"),
    [
        ({"ROS_DOMAIN_ID": "300"}, "ROS_DOMAIN_ID", "wrong"),
        ({"ROS_DOMAIN_ID": "x"}, "ROS_DOMAIN_ID", "wrong"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "discovery", "look"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "discovery", "wrong"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "discovery", "ok"),
        ({}, "discovery", "ok"),
        (
            {"FASTRTPS_DEFAULT_PROFILES_FILE": "/no/such.xml"},
            "FASTRTPS_DEFAULT_PROFILES_FILE",
            "wrong",
        ),
    ],
)
def test_variables_of_ros(variables: dict[str, str], what: str, level: str) -> None:
    found = levels(ros.middleware(variables))
    assert found[what] == level
    others = {key: value for key, value in found.items() if key not in {what, "middleware"}}
    assert set(others.values()) <= {"ok"}


def test_shared_memory_that_is_not_there(tmp_path: Path) -> None:
    found = list(ros.shared_memory(tmp_path / "none"))
    assert [f.level for f in found] in (["wrong"], [])  # other systems have none


@pytest.mark.skipif(os.name != "posix" or not Path("/dev/shm").is_dir(), reason="Linux alone")  # noqa: S108
def test_shared_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(2):
        for name in (f"fastrtps_{number:016x}", f"fastrtps_{number:016x}_el"):
            (tmp_path / name).write_bytes(bytes(2_000_000))
            os.utime(tmp_path / name, (1.0, 1.0))
    monkeypatch.setattr(ros.shutil, "disk_usage", lambda _: SimpleNamespace(free=64e6))
    found = list(ros.shared_memory(tmp_path))
    assert [f.level for f in found] == ["wrong", "look"]
    assert "64 MB" in found[0].seen
    assert "2 segments of Fast DDS, 4 MB" in found[1].seen


@pytest.mark.parametrize(
    ("told", "level", "words"),
    [
        ({"found_s": -1.0, "sent": 0, "received": 0, "median_ms": 0.0}, "wrong", "do not find"),
        ({"found_s": 0.5, "sent": 20, "received": 0, "median_ms": 0.0}, "wrong", "0 of 20"),
        ({"found_s": 0.5, "sent": 20, "received": 12, "median_ms": 4.0}, "look", "12 of 20"),
        ({"found_s": 0.5, "sent": 20, "received": 20, "median_ms": 4.0}, "ok", "in 4.0 ms"),
    ],
)
def test_what_a_conversation_tells(told: dict[str, float], level: str, words: str) -> None:
    found = ros._heard(told)
    assert found.level == level
    assert words in found.seen


def test_an_examination_that_fails_is_a_finding() -> None:
    def broken() -> Iterator[Finding]:
        yield Finding("ok", "this", "fine")
        raise RuntimeError("no\nsuch thing")

    found = list(examined(broken, "that"))
    assert [f.level for f in found] == ["ok", "look"]
    assert found[1].seen == "could not be looked at (RuntimeError: no such thing)"


def test_how_it_stands() -> None:
    fine, look, wrong = (Finding(level, "x", "y") for level in ("ok", "look", "wrong"))
    assert command.in_words([fine]) == "nothing wrong"
    assert command.in_words([fine, look]) == "nothing wrong, 1 to look at"
    assert command.in_words([wrong, look]).startswith("1 wrong, 1 to look at")


@pytest.mark.parametrize(("level", "code"), [("ok", 0), ("look", 0), ("wrong", 1)])
def test_exit_code_and_json(
    level: Any, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finding = Finding(level, "this", "[bold]seen[/bold]", "do that")
    monkeypatch.setattr(command, "findings", lambda **_: iter([finding]))
    assert run_command(["doctor", "--json"]) == code
    assert json.loads(capsys.readouterr().out) == [finding.as_json()]
    assert run_command(["doctor"]) == code
    text = capsys.readouterr().out
    # What was seen is not markup, and a pipe gets no colours.
    assert "this: [bold]seen[/bold]" in text
    assert "do that" in text
    assert "\x1b" not in text
