"""Compiled kernels are kept, and thrown away with the source they were made of."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

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
    value, misses = said(directory, code, **environment)
    return float(value), int(misses)


def said(directory: Path, code: str, **environment: str) -> list[str]:
    """Run code in a process of its own; the words that it prints."""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=directory,
        env={**os.environ, "PYTHONPATH": str(directory), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout.split()


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


def test_kernels_are_compiled_as_soon_as_pays_unless_told_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package(tmp_path, 2.0)
    monkeypatch.delenv("NUMBA_OPT", raising=False)
    code = "import kernels.jit, numba; print(int(numba.config.OPT))"
    assert said(tmp_path, code) == ["1"]
    assert said(tmp_path, code, NUMBA_OPT="3") == ["3"]


# Saves two variants of a kernel: the second, once told to.
SAVER = """
import sys
from kernels.inner import inner
inner(1.0)
print("first", flush=True)
sys.stdin.readline()
inner({argument})
print(len(inner.stats.cache_misses), flush=True)
"""


def test_two_processes_that_save_at_once_do_not_mix_up_variants(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    package(tmp_path, 2.0)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path)}
    savers = [
        subprocess.Popen(
            [sys.executable, "-c", SAVER.format(argument=argument)],
            cwd=tmp_path,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for argument in ("2", "2j")
    ]
    outputs, inputs = [], []
    for saver in savers:
        assert saver.stdout is not None
        assert saver.stdin is not None
        assert saver.stdout.readline() == "first\n"
        outputs.append(saver.stdout)
        inputs.append(saver.stdin)
    (lock,) = tmp_path.rglob("lock")
    with lock.open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        for stream in inputs:
            stream.write("\n")
            stream.flush()
        # Whoever has compiled its variant waits for the lock.
        before = {path for path in tmp_path.rglob("*.nbc") if "inner" in path.name}
        assert not select.select(outputs, [], [], 2.0)[0]
        assert {path for path in tmp_path.rglob("*.nbc") if "inner" in path.name} == before
    for saver, stream in zip(savers, inputs, strict=True):
        stream.close()
        assert saver.wait(60.0) == 0
        assert saver.stdout is not None
        saver.stdout.close()
    # One file for each of three variants, and each is what its list says.
    kept = [path for path in tmp_path.rglob("*.nbc") if "inner" in path.name]
    assert len(kept) == 3
    code = "from kernels.inner import inner; print(inner(1.5), inner(3), inner(2j))"
    words = said(tmp_path, code, NUMBA_CACHE_DIR=str(tmp_path))
    assert words == ["3.0", "6.0", "4j"]
