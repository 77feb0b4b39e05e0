"""Numba's compiler behind a typed decorator."""

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
