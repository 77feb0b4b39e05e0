"""Hashes that say whether something was made by the same code before."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pipeline_tracker
from pipeline_tracker import __version__
from pipeline_tracker.resources import message_directory


def code_hash(wanted: Callable[[str], bool]) -> str:
    """Return a hash of the package's code and messages, 16 hexadecimal digits.

    Args:
        wanted: told a module or sub-package by its file's name, says whether it counts.
    """
    package = Path(next(iter(pipeline_tracker.__path__)))
    modules = sorted(package.rglob("*.py"))
    named = [
        (file.relative_to(package).as_posix(), file)
        for file in modules
        if wanted(file.relative_to(package).parts[0])
    ]
    named += [(file.name, file) for file in sorted(message_directory().glob("*.msg"))]
    digest = hashlib.sha256(__version__.encode())
    for name, file in named:
        # Line ends are no difference between two machines.
        content = file.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]
