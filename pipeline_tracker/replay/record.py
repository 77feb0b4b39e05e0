"""replay.yaml: what a directory of results was made of, and whether the replay ended."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import scipy
import yaml

from pipeline_tracker import __version__
from pipeline_tracker.errors import BagError
from pipeline_tracker.files import write_whole
from pipeline_tracker.fingerprint import code_hash

RECORD = "replay.yaml"
_COMMENT = (
    "# What was replayed here, and by what: `pipeline-tracker replay --resume` compares it.\n"
)
_LARGEST = 100_000
# These have no part in a replay's numbers.
_NO_PART = ("bench", "benchmark", "cli", "evaluation", "nodes", "report", "simulation")
# Of a bag's files so many pieces are looked at, evenly spread.
_PIECES, _PIECE = 256, 65536
_STORAGES = {".mcap", ".db3", ".bag"}


def write_record(output: Path, bag: Path, *, finished: bool) -> None:
    """Write what a directory is made of.

    Raises:
        OSError: it cannot be written, or the bag cannot be read.
    """
    record = {"bag": bag.resolve().name, **_made_of(bag), "finished": finished}
    write_whole(output / RECORD, _COMMENT + yaml.safe_dump(record, sort_keys=False))


def check_record(output: Path, bag: Path) -> bool:
    """Check that a directory was made of this bag and by this version.

    Returns:
        Whether the replay in it has ended.

    Raises:
        BagError: it was not, or it cannot be told.
        OSError: bag or directory cannot be read.
    """
    record = _read(output / RECORD)
    again = "or begin again with --force"
    for name, value in _made_of(bag).items():
        old = str(record.get(name))[:80]
        if old == value:
            continue
        if name == "hash":
            was = str(record.get("bag"))[:80]
            raise BagError(
                f"{output}: cannot be resumed with {bag}, it has another bag ({was}), "
                f"or that one before it was changed; give that bag, {again}"
            )
        raise BagError(
            f"{output}: cannot be resumed by another version, {name} is {value}, and was {old}; "
            f"go on with that one, {again}"
        )
    return record.get("finished") is True


def _made_of(bag: Path) -> dict[str, str]:
    libraries = {"numba": numba, "numpy": np, "opencv": cv2, "scipy": scipy}
    return {
        "hash": bag_hash(bag),
        "version": __version__,
        "code": code_hash(lambda name: name not in _NO_PART),
        "libraries": ", ".join(f"{name} {one.__version__}" for name, one in libraries.items()),
    }


def bag_hash(bag: Path) -> str:
    """Return a hash of what is in a bag; of a large one 16 MiB are looked at, evenly spread.

    Raises:
        OSError: it cannot be read.
    """
    files = [bag]
    if bag.is_dir():
        files = sorted(f for f in bag.iterdir() if set(f.suffixes) & _STORAGES)
        files += [f for f in (bag / "metadata.yaml",) if f.exists()]
    digest = hashlib.sha256()
    pieces = max(2, _PIECES // max(1, len(files)))
    for file in files:
        size = file.stat().st_size
        digest.update(f"{size} ".encode())
        with file.open("rb") as stream:
            for place in [*range(0, size, max(_PIECE, size // pieces)), max(0, size - _PIECE)]:
                stream.seek(place)
                digest.update(stream.read(_PIECE))
    return digest.hexdigest()[:16]


def _read(path: Path) -> dict[str, Any]:
    reason = "it is no table"
    record = None
    try:
        with path.open("rb") as file:
            record = yaml.safe_load(file.read(_LARGEST))
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())[:80]
    if not isinstance(record, dict):
        raise BagError(f"{path}: cannot be read ({reason}); begin again with --force")
    return record
