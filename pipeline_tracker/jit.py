"""Numba's compiler behind typed decorators."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a numeric kernel to machine code and keep it in Numba's file cache.

    Strict floating point (no ``fastmath``): the same input gives the same bits in every process,
    which is what makes live nodes and offline replay agree.
    """
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def compiled_sums(function: Function) -> Function:
    """Compile a kernel of long sums, which may be added up in another order, several at once.

    The order is that of the machine code: the same input gives the same bits in every process of
    one machine, but not on another kind of CPU. NaN and infinity keep their meaning.
    """
    flags = {"contract", "reassoc", "arcp", "nsz"}
    compile_ = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=flags)
    return cast(Function, compile_(function))
