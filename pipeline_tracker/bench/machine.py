"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

import cv2
import numba
import numpy as np
import scipy

from pipeline_tracker.bench.schema import Machine

_CPUINFO = Path("/proc/cpuinfo")


def load_average() -> list[float] | None:
    """Return the load average over 1, 5 and 15 min; None where the system has none."""
    return [round(value, 2) for value in os.getloadavg()] if hasattr(os, "getloadavg") else None


def describe_machine(load_before: list[float] | None) -> Machine:
    """Describe this machine; the load is that of now, and one from before."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    return Machine(
        processor=_processor(),
        cores=len(cores) or os.cpu_count() or 1,
        core=max(cores) if cores else None,
        load_before=load_before,
        load_after=load_average(),
        versions={
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "numba": numba.__version__,
            "scipy": scipy.__version__,
        },
    )


def _processor() -> str:
    if sys.platform == "linux" and _CPUINFO.is_file():
        for line in _CPUINFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() in {"model name", "Model"}:
                return value.strip()
    return platform.processor() or platform.machine()
