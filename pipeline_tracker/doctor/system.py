"""Python, the libraries that compute, processor, memory and the cache of compiled kernels."""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distributions, version
from importlib.util import find_spec
from pathlib import Path

from pipeline_tracker import __version__
from pipeline_tracker.doctor.finding import Finding

_OLDEST, _NEWEST = (3, 10), (3, 13)
_LIBRARIES = ("numpy", "numba", "scipy", "rosbags", "pydantic", "yaml", "typer")
_EXTRAS = {
    "sim": ("embreex", "trimesh"),
    "bench": ("psutil", "skimage"),
    "cluster": ("distributed",),
    "export": ("pyproj",),
    "video": ("av",),
}
_LEAST_MEMORY = 1.0e9
_KIB = 1024


def python() -> Iterator[Finding]:
    """Look at Python and the package itself."""
    seen = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    if _OLDEST <= sys.version_info[:2] <= _NEWEST:
        yield Finding("ok", "Python", seen)
    else:
        yield Finding(
            "look", "Python", seen, "Tested are 3.10 to 3.13; make an environment with one of them"
        )
    yield Finding("ok", "pipeline_tracker", f"{__version__} in {Path(__file__).parents[1]}")


def libraries() -> Iterator[Finding]:
    """Look at the libraries that compute."""
    seen = []
    for name in _LIBRARIES:
        try:
            module = import_module(name)
        except Exception as error:  # noqa: BLE001, PERF203 - libraries fail in many ways
            yield Finding(
                "wrong",
                name,
                f"cannot be imported ({type(error).__name__}: {error})",
                "Install pipeline_tracker again, in an environment of its own",
            )
        else:
            seen.append(f"{name} {getattr(module, '__version__', None) or _version_of(name)}")
    yield Finding("ok" if seen else "wrong", "libraries", ", ".join(seen))
    yield from _opencv()
    missing = {
        extra: [module for module in modules if find_spec(module) is None]
        for extra, modules in _EXTRAS.items()
    }
    there = [extra for extra, modules in missing.items() if not modules]
    absent = [extra for extra, modules in missing.items() if modules]
    # Nobody needs all of them: that one is not there is no fault.
    advice = f"Where needed: pip install '.[{','.join(absent)}]' in the clone" if absent else ""
    yield Finding("ok", "extras", ", ".join(there) or "none", advice)


def _opencv() -> Iterator[Finding]:
    builds = sorted(
        {
            str(found.metadata["Name"])
            for found in distributions()
            if re.match(r"opencv[-_](contrib[-_])?python", str(found.metadata["Name"] or ""))
        }
    )
    try:
        cv2 = import_module("cv2")
    except Exception as error:  # noqa: BLE001 - a library of the system may be missing
        yield Finding(
            "wrong",
            "OpenCV",
            f"cannot be imported ({error})",
            "pip install opencv-python-headless, which needs no libraries of a desktop",
        )
        return
    seen = f"{cv2.__version__} ({', '.join(builds) or 'of the system'})"
    if len(builds) > 1:
        yield Finding(
            "wrong",
            "OpenCV",
            seen,
            "These builds overwrite one another: uninstall all, then install one",
        )
        return
    parts = [name for name in ("createCLAHE", "imdecode", "remap") if not hasattr(cv2, name)]
    if parts:
        yield Finding(
            "wrong", "OpenCV", f"{seen} lacks {', '.join(parts)}", "Install OpenCV 4.6 or newer"
        )
        return
    yield Finding("ok", "OpenCV", seen)


def _version_of(name: str) -> str:
    try:
        return version({"yaml": "PyYAML"}.get(name, name))
    except PackageNotFoundError:
        return "of unknown version"


def kernels() -> Iterator[Finding]:
    """Look whether compiled kernels can be kept, so that only the first start has to compile."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    place = Path(given) if given else Path(__file__).parents[1]
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        yield Finding(
            "wrong",
            "kernels",
            "NUMBA_DISABLE_JIT is set: nothing is compiled",
            "Unset it; a frame takes minutes without",
        )
        return
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        # Numba then takes a directory of the user's, where there is one.
        yield Finding(
            "look",
            "kernels",
            f"cannot be kept in {place} ({error.strerror})",
            "Set NUMBA_CACHE_DIR to a directory that can be written to, or each start may compile",
        )
        return
    kept = sum(1 for _ in place.rglob("*.nbi"))
    seen = f"{kept} kept in {place}" if kept else f"none compiled yet in {place}"
    advice = "" if kept else "The first start compiles them, for half a minute or so"
    yield Finding("ok", "kernels", seen, advice)


def processor() -> Iterator[Finding]:
    """Look at cores, their clock and the memory."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    cores = allowed or os.cpu_count() or 1
    if cores == 1:
        yield Finding(
            "look",
            "processor",
            "1 core for this process",
            "Give it two (taskset, cgroup): while it searches it would hold up the autopilot",
        )
    else:
        yield Finding("ok", "processor", f"{cores} cores")
    governors = {
        file.read_text(encoding="utf-8").strip()
        for file in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    }
    if "powersave" in governors:
        yield Finding(
            "look",
            "clock",
            "the governor is powersave",
            "On a vehicle: cpupower frequency-set -g performance",
        )
    if hasattr(os, "getloadavg"):
        load = os.getloadavg()[0]
        if load > cores:
            yield Finding(
                "look",
                "load",
                f"{load:.1f} over the last minute on {cores} cores",
                "Other programs take the processor: latencies will be long",
            )
    free = _available_memory()
    if free is not None:
        enough = free >= _LEAST_MEMORY
        advice = (
            "" if enough else "Leave 1 GB free: the nodes take up to 0.4 GB, images come on top"
        )
        yield Finding("ok" if enough else "look", "memory", f"{free / 1e9:.1f} GB free", advice)


def _available_memory() -> float | None:
    """Return the memory that may still be taken, bytes; None where the system does not tell."""
    try:
        text = Path("/proc/meminfo").read_text(encoding="utf-8")
    except OSError:
        return None
    found = re.search(r"^MemAvailable:\s*(\d+) kB$", text, re.MULTILINE)
    return None if found is None else float(found[1]) * _KIB
