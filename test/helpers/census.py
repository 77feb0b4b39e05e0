"""How much our objects hold: the lengths of all containers that can be reached from one."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from functools import partial
from types import FunctionType, MethodType
from typing import Any

import numpy as np

OURS = "pipeline_tracker"
SEQUENCES = (list, tuple, set, frozenset, deque)


def census(root: Any) -> Counter[str]:
    """Return lengths of containers, and bytes of arrays, by the way that leads to them.

    What a container's items hold is summed up in one. Others' objects are not looked into.
    """
    held: Counter[str] = Counter()
    seen: set[int] = set()
    waiting: deque[tuple[str, Any]] = deque([("", root)])
    while waiting:
        way, thing = waiting.popleft()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        if isinstance(thing, np.ndarray):
            held[f"{way} bytes"] += thing.nbytes
        elif isinstance(thing, (dict, *SEQUENCES)):
            held[way] += len(thing)
        waiting += parts(way, thing)
    return held


def parts(way: str, thing: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(thing, dict):
        yield from ((f"{way}[]", one) for item in thing.items() for one in item)
    elif isinstance(thing, SEQUENCES):
        yield from ((f"{way}[]", one) for one in thing)
    elif isinstance(thing, partial):
        yield f"{way}()", (thing.func, thing.args, thing.keywords)
    elif isinstance(thing, MethodType):
        yield way, thing.__self__
    elif isinstance(thing, FunctionType):
        yield from ((f"{way}()", cell.cell_contents) for cell in thing.__closure__ or ())
    elif type(thing).__module__.split(".")[0] == OURS:
        names = (name for name in dir_of(thing) if hasattr(thing, name))
        yield from ((f"{way}.{name}", getattr(thing, name)) for name in names)


def dir_of(thing: Any) -> list[str]:
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    return [*getattr(thing, "__dict__", {}), *slots]


def grown(before: Counter[str], after: Counter[str], slack: int) -> dict[str, tuple[int, int]]:
    """Return what holds more than before, by more than ``slack`` items, or 10 % of the bytes."""
    return {
        way: (before[way], count)
        for way, count in after.items()
        if count > before[way] + (max(4096, before[way] // 10) if "bytes" in way else slack)
    }
