"""The true axis of the pipe, a polyline, and distances from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

# Pieces of overlapping polylines whose ends agree so far are one piece, m.
_SAME = 1e-6
# A vertex so near to another polyline's piece, as a share of its length, is between its ends.
_BESIDE = 0.02


class TrueAxis:
    """The true axis, put together from polylines that may overlap (the stretch of each frame)."""

    def __init__(self, polylines: Iterable[Array]) -> None:
        """Put polylines together.

        Args:
            polylines: (M, 3) each, m, world; those of fewer than two vertices have no length and
                are left out.
        """
        lines = [line for line in polylines if len(line) > 1]
        joined = _refined(lines) if lines else np.zeros((0, 2, 3))
        self._start, self._way = joined[:, 0], joined[:, 1] - joined[:, 0]
        middles = joined.mean(axis=1)
        self._tree = cKDTree(middles) if len(joined) else None
        self._reach = float(np.linalg.norm(self._way, axis=1).max() / 2.0) if len(joined) else 0.0

    @property
    def empty(self) -> bool:
        """Whether there is no pipe."""
        return self._tree is None

    def nearest(self, point: Array) -> Array:
        """Return the point of the axis nearest to a point (3,), between vertices too; (3,), m.

        Raises:
            ValueError: there is no axis.
        """
        return self._nearest(point)[0]

    def tangent(self, point: Array) -> Array:
        """Return the direction of the axis (either way), unit, (3,), at its nearest point.

        Raises:
            ValueError: there is no axis.
        """
        return self._nearest(point)[1]

    def _nearest(self, point: Array) -> tuple[Array, Array]:
        if self._tree is None:
            raise ValueError("there is no axis to be near to")
        # No piece whose middle is further than this can hold the nearest point.
        bound, _ = self._tree.query(point)
        near = self._tree.query_ball_point(point, float(bound) + self._reach + _SAME)
        start, way = self._start[near], self._way[near]
        squared = np.sum(way * way, axis=1)
        share = np.clip(np.sum((point - start) * way, axis=1) / squared, 0.0, 1.0)
        feet = start + share[:, None] * way
        best = int(np.argmin(np.linalg.norm(feet - point, axis=1)))
        return feet[best], way[best] / np.sqrt(squared[best])


def _unique(points: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Tell rows (N, K) that agree: indices (M,) of the first of each, and for each row which."""
    keys = np.round(points / _SAME).astype(np.int64)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.argsort(order)
    return first[order], place[which.reshape(-1)]


def _refined(lines: list[Array]) -> Array:
    """Return the pieces of polylines, divided at vertices of others that lie between their ends.

    All vertices are on the axis, wherever each polyline begins. Without this an estimate would be
    measured to whichever of several chords happens to be nearest, which flatters it.

    Args:
        lines: (M, 3) each, M at least 2, m.

    Returns:
        Start and end of each piece, (N, 2, 3), m, each once.
    """
    listed = np.concatenate(lines)
    numbers = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    first, which = _unique(listed)
    vertices = listed[first]
    # The polylines that each vertex is of: their own order says where it belongs.
    owners: list[set[int]] = [set() for _ in vertices]
    for vertex, number in zip(which.tolist(), numbers.tolist(), strict=True):
        owners[vertex].add(number)
    same = numbers[:-1] == numbers[1:]
    pieces = np.stack((listed[:-1], listed[1:]), axis=1)[same]
    number_of = numbers[:-1][same]
    once, _ = _unique(pieces.reshape(-1, 6))
    pieces, number_of = pieces[once], number_of[once]
    reach = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) / 2.0
    around = cKDTree(vertices).query_ball_point(pieces.mean(axis=1), reach)
    refined = []
    for (start, end), number, near in zip(pieces, number_of.tolist(), around, strict=True):
        others = vertices[[i for i in near if number not in owners[i]]]
        whole = np.concatenate((start[None], _between(start, end, others), end[None]))
        refined.append(np.stack((whole[:-1], whole[1:]), axis=1))
    joined: Array = np.concatenate(refined)
    joined = joined[np.linalg.norm(joined[:, 1] - joined[:, 0], axis=1) > _SAME]
    kept: Array = joined[_unique(joined.reshape(-1, 6))[0]]
    return kept


def _between(start: Array, end: Array, points: Array) -> Array:
    """Return those of some points (K, 3) that lie beside a piece, in order along it."""
    way = end - start
    length = float(np.linalg.norm(way))
    if not length > _SAME:
        return points[:0]
    share = (points - start) @ way / length**2
    off = np.linalg.norm(points - start - share[:, None] * way, axis=1)
    edge = _SAME / length
    chosen = (off <= _BESIDE * length) & (share > edge) & (share < 1.0 - edge)
    found: Array = points[chosen][np.argsort(share[chosen])]
    return found


@dataclass(frozen=True)
class Divergence:
    """How far a straight segment is off the axis: the paper's measure (5.1).

    Attributes:
        ends: distances of start and end from the axis, m.
        horizontal, vertical: sums over both ends of the components of these, m.
    """

    ends: tuple[float, float]
    horizontal: float
    vertical: float

    @property
    def total(self) -> float:
        """Sum of the distances of both ends, m."""
        return self.ends[0] + self.ends[1]


def divergence(start: Array, end: Array, axis: TrueAxis) -> Divergence:
    """Measure the divergence of a segment from the true axis.

    Args:
        start, end: ends of the segment in world, (3,), m.
        axis: the true axis.
    """
    errors = [point - axis.nearest(point) for point in (start, end)]
    return Divergence(
        ends=(float(np.linalg.norm(errors[0])), float(np.linalg.norm(errors[1]))),
        horizontal=float(sum(np.hypot(e[0], e[1]) for e in errors)),
        vertical=float(sum(abs(e[2]) for e in errors)),
    )
