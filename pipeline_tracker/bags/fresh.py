"""Writing a bag whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline_tracker.errors import BagError


@contextmanager
def fresh_bag(output: Path) -> Iterator[Path]:
    """Give a place to write a bag to, and put the bag in its place once it is whole.

    The bag is written beside ``output`` and moved there when the block ends; when it ends with an
    error or is interrupted nothing is left behind.

    Raises:
        BagError: ``output`` is a file or a directory that is not empty, or cannot be written.
    """
    output = output.resolve()
    try:
        if output.is_dir() and any(output.iterdir()):
            raise BagError(f"{output} is not empty; give another --output or remove it first")
        if output.exists() and not output.is_dir():
            raise BagError(f"{output} is a file, expected a new directory; give another --output")
        output.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{output.name}-", dir=output.parent))
        try:
            # The bag's files carry its directory's name, so it has that name already.
            yield scratch / output.name
            if output.is_dir():
                output.rmdir()
            (scratch / output.name).replace(output)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise BagError(
            f"{output} cannot be written ({error.strerror or error}); "
            "give another --output, or make room"
        ) from error
