"""Hashes that say whether something was made from the same things before."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from pipeline_tracker.fingerprint import code_hash

# What a simulated bag is made by. Not the settings' modules: the scenario's models only inherit
# from them, and all values of a scenario are in its hash.
SIMULATOR = (
    "bags",
    "camera_info.py",
    "errors.py",
    "geometry",
    "jit.py",
    "messages.py",
    "resources.py",
    "simulation",
    "types.py",
    "validation",
)
# What replays and measures has no part of these.
_NOT_MEASURING = ("benchmark", "cli", "nodes", "simulation")


@cache
def simulator_code() -> str:
    """Return the hash of the code that simulates."""
    return code_hash(lambda name: name in SIMULATOR)


@cache
def measuring_code() -> str:
    """Return the hash of the code that replays and evaluates."""
    return code_hash(lambda name: name not in _NOT_MEASURING)


def hash_of(*parts: Any) -> str:
    """Return a hash of plain values (of whatever JSON can hold), 16 hexadecimal digits."""
    text = json.dumps(parts, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def bag_fingerprint(bag: Path) -> list[list[Any]]:
    """Return names, sizes and times of change of a bag's files: what tells that it is another.

    Raises:
        OSError: it cannot be looked at.
    """
    files = sorted(bag.rglob("*")) if bag.is_dir() else [bag]
    stats = [(file, file.stat()) for file in files if file.is_file()]
    return [
        [file.relative_to(bag.parent).as_posix(), stat.st_size, stat.st_mtime_ns]
        for file, stat in stats
    ]
