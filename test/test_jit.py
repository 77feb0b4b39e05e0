"""Compiled kernels are kept, and thrown away with the source they were made of."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

INNER = """
from kernels.jit import compiled


@compiled
def inner(x: float) -> float:
    return {factor} * x
"""
OUTER = """
from kernels.inner import inner
from kernels.jit import compiled


@compiled
def outer(x: float) -> float:
    return inner(x) + 1.0
"""


def package(directory: Path, factor: float) -> None:
    """Write a package with two kernels, of which one calls the other."""
    import pipeline_tracker

    place = directory / "kernels"
    place.mkdir(exist_ok=True)
    (place / "__init__.py").touch()
    real = Path(pipeline_tracker.__file__).with_name("jit.py")
    (place / "jit.py").write_bytes(real.read_bytes())
    (place / "inner.py").write_text(INNER.format(factor=factor))
    if not (place / "outer.py").exists():
        (place / "outer.py").write_text(OUTER)


def answer(directory: Path, **environment: str) -> tuple[float, int]:
    """Run the outer kernel in a process of its own: its result, and how often it was compiled."""
    code = (
        "from kernels.outer import outer; x = outer(1.0);"
        "print(x, sum(outer.stats.cache_misses.values()))"
    )
    environment = {**os.environ, "PYTHONPATH": str(directory), **environment}
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=directory,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    value, misses = ran.stdout.split()
    return float(value), int(misses)


def test_a_changed_kernel_is_changed_where_it_is_called_too(tmp_path: Path) -> None:
    package(tmp_path, 2.0)
    assert answer(tmp_path) == (3.0, 1)
    assert answer(tmp_path) == (3.0, 0)
    package(tmp_path, 5.0)
    assert answer(tmp_path) == (6.0, 1)
    # The kernels of before are still there.
    package(tmp_path, 2.0)
    assert answer(tmp_path) == (3.0, 0)


def test_sets_long_unused_are_dropped_and_the_user_says_where(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    for factor in (1.0, 2.0, 3.0, 4.0, 5.0):
        package(tmp_path, factor)
        assert answer(tmp_path, NUMBA_CACHE_DIR=str(cache)) == (factor + 1.0, 1)
    assert len(list((cache / "kernels").iterdir())) == 3
    assert not list((tmp_path / "kernels").rglob("*.nbi"))


def test_without_a_place_to_keep_them_kernels_are_compiled_all_the_same(tmp_path: Path) -> None:
    package(tmp_path, 2.0)
    blocked = tmp_path / "file"
    blocked.touch()
    value, _ = answer(tmp_path, NUMBA_CACHE_DIR=str(blocked / "cache"))
    assert value == 3.0


def test_it_is_known_whether_kernels_are_kept(tmp_path: Path) -> None:
    def kept() -> str:
        code = "from kernels.jit import kernels_are_kept; print(kernels_are_kept())"
        environment = os.environ | {"PYTHONPATH": str(tmp_path)}
        command = [sys.executable, "-c", code]
        return subprocess.check_output(command, cwd=tmp_path, env=environment, text=True).strip()

    package(tmp_path, 2.0)
    assert kept() == "False"
    answer(tmp_path)
    assert kept() == "True"
    # Another source has kernels of its own.
    package(tmp_path, 3.0)
    assert kept() == "False"
