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
        pieces = [np.stack((line[:-1], line[1:]), axis=1) for line in polylines if len(line) > 1]
        joined = np.concatenate(pieces) if pieces else np.zeros((0, 2, 3))
        joined = joined[np.any(joined[:, 0] != joined[:, 1], axis=1)]
        if len(joined):
            joined = _unique(_refined(_unique(joined)))
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


def _unique(pieces: Array) -> Array:
    keys = np.round(pieces.reshape(-1, 6) / _SAME).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    kept: Array = pieces[np.sort(first)]
    return kept


def _refined(pieces: Array) -> Array:
    """Divide pieces at the vertices of other polylines that lie between their ends.

    All vertices are on the axis, wherever each polyline begins. Without this an estimate would be
    measured to whichever of several chords happens to be nearest, which flatters it.

    Args:
        pieces: start and end, (N, 2, 3), m.
    """
    vertices = np.unique(pieces.reshape(-1, 3), axis=0)
    ways = pieces[:, 1] - pieces[:, 0]
    lengths = np.linalg.norm(ways, axis=1)
    within = cKDTree(vertices).query_ball_point(pieces.mean(axis=1), lengths / 2.0)
    refined = []
    for (start, end), way, length, near in zip(pieces, ways, lengths, within, strict=True):
        aside = vertices[near] - start
        share = aside @ way / length**2
        off = np.linalg.norm(aside - share[:, None] * way, axis=1)
        edge = _SAME / length
        between = (off <= _BESIDE * length) & (share > edge) & (share < 1.0 - edge)
        middle = vertices[near][between][np.argsort(share[between])]
        line = np.concatenate((start[None], middle, end[None]))
        refined.append(np.stack((line[:-1], line[1:]), axis=1))
    whole: Array = np.concatenate(refined)
    return whole[np.any(whole[:, 0] != whole[:, 1], axis=1)]


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
