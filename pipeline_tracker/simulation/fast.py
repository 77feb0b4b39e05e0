"""Numba's compiler for kernels of the renderer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])

# Sums may be regrouped and divisions become multiplications: a third less time. Infinity and NaN
# keep their meaning.
_FREEDOM = {"arcp", "contract", "nsz", "reassoc"}


def fast(function: Function) -> Function:
    """Compile a kernel whose last bits may depend on the machine, but on nothing else.

    The same machine gives the same bits in every process and with any number of threads.
    """
    compile_it = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FREEDOM)
    return cast(Function, compile_it(function))
