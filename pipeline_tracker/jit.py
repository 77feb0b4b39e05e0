"""Numba's compiler behind typed decorators."""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import caching

try:
    import fcntl
except ImportError:  # Windows has none
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
# So many sets of compiled kernels are kept, the one in use among them.
_KEPT = 3


def _fingerprint() -> str:
    """Return a hash of all modules with kernels.

    A kernel has those that it calls compiled in, also from other modules. Numba looks for changes
    in a kernel's own module alone, and would go on with the old ones.
    """
    digest = hashlib.sha256()
    marker = f"{_PACKAGE.name}.jit import".encode()
    for path in sorted(_PACKAGE.rglob("*.py")):
        text = path.read_bytes()
        if marker in text or path.samefile(__file__):
            digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def _keep_kernels() -> None:
    """Have Numba keep kernels in a directory of this very source; drop those long unused.

    Below NUMBA_CACHE_DIR where that is given, else in the package. Where neither can be written to,
    Numba chooses.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    base = (Path(given) if given else _PACKAGE / "__pycache__") / "kernels"
    try:
        mine = base / _fingerprint()
        mine.mkdir(parents=True, exist_ok=True)
        os.utime(mine)
        sets = sorted(base.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        if not os.access(mine, os.W_OK):
            return
    except OSError:
        return
    for old in sets[_KEPT:]:
        shutil.rmtree(old, ignore_errors=True)
    numba.config.CACHE_DIR = str(mine)  # type: ignore[attr-defined]  # made at run time


_keep_kernels()


def _compile_sooner() -> None:
    """Have Numba optimise as much as pays: more takes a fifth longer, and kernels are no faster.

    ``NUMBA_OPT`` says otherwise.
    """
    if "NUMBA_OPT" not in os.environ:
        level = type(numba.config.OPT)  # type: ignore[attr-defined]  # made at run time
        numba.config.OPT = level(1)  # type: ignore[attr-defined]


_compile_sooner()
# No kernel is called from C: what that would need takes time to compile as well.
_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}


def _save_one_at_a_time() -> None:
    """Let one process at a time save kernels.

    Numba reads the list of a kernel's variants, writes the code of a new one under the next number,
    and the list again. Of two processes at it at once, one may list the other's code as its own,
    for arguments of other types.
    """
    if fcntl is None or not hasattr(caching.IndexDataCacheFile, "save"):
        return
    save = caching.IndexDataCacheFile.save

    @functools.wraps(save)
    def save_alone(self: caching.IndexDataCacheFile, key: object, data: object) -> None:
        place = str(numba.config.CACHE_DIR)  # type: ignore[attr-defined]  # made at run time
        with ExitStack() as stack:
            with suppress(OSError):
                # Where Numba keeps kernels in a place of its own, it is for itself.
                if place:
                    lock = stack.enter_context((Path(place) / "lock").open("ab"))
                    fcntl.flock(lock, fcntl.LOCK_EX)
            save(self, key, data)  # type: ignore[no-untyped-call]

    caching.IndexDataCacheFile.save = save_alone  # type: ignore[method-assign]


_save_one_at_a_time()


def kernels_are_kept() -> bool:
    """Return whether kernels of this source have been compiled before, as far as can be told."""
    place = str(numba.config.CACHE_DIR)  # type: ignore[attr-defined]  # made at run time
    return not place or any(Path(place).rglob("*.nbi"))


def compiled(function: Function) -> Function:
    """Compile a numeric kernel to machine code and keep it in Numba's file cache.

    Strict floating point (no ``fastmath``): the same input gives the same bits in every process,
    which is what makes live nodes and offline replay agree.
    """
    return cast(Function, numba.njit(**_OPTIONS)(function))


def compiled_sums(function: Function) -> Function:
    """Compile a kernel of long sums, which may be added up in another order, several at once.

    The order is that of the machine code: the same input gives the same bits in every process of
    one machine, but not on another kind of CPU. NaN and infinity keep their meaning.
    """
    flags = {"contract", "reassoc", "arcp", "nsz"}
    return cast(Function, numba.njit(fastmath=flags, **_OPTIONS)(function))
