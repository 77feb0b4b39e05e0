"""Manifests of seas so small that a benchmark takes seconds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

# A coarse bed and small images: the same code in a fraction of the time.
TINY = "set: {frames: 2, camera: {width: 96, height: 64}, bed: {resolution: 0.1, stones: 0.1}}\n"


@pytest.fixture
def write_manifest(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes a manifest."""

    def write(text: str, *, tiny: bool = True) -> Path:
        path = tmp_path / "bench.yaml"
        path.write_text((TINY if tiny else "") + text, encoding="utf-8")
        return path

    return write
