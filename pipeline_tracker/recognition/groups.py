"""Groups of segments that may form a contour (4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """Segments of like direction and position.

    Attributes:
        line: x cosθ + y sinθ = ρ as (θ, ρ), rad and px, origin at the picture's centre.
        weight: sum of the segments' contributions, px.
        members: (K,) indices of the segments.
    """

    line: tuple[float, float]
    weight: float
    members: NDArray[np.int64]


@compiled
def _assign(
    middles: Array,
    ways: Array,
    lengths: Array,
    order: NDArray[np.int64],
    distance: float,
    angle: float,
    long: float,
    labels: NDArray[np.int64],
    sums: Array,
) -> int:
    """Give each segment, longest first, to the nearest group or to one of its own.

    Args:
        middles: of the segments, (N, 2), px.
        ways: their unit directions, (N, 2).
        lengths: (N,), px.
        order: longest first, (N,).
        distance, angle, long: see ``form_groups``.
        labels: (N,), filled with each segment's group, -1 where it has none.
        sums: (groups, 6), filled with length, Σ l x, Σ l y, Σ l cos 2φ, Σ l sin 2φ, contributions.

    Returns:
        How many groups.
    """
    count = 0
    # Middle and unit direction of each group.
    lines = np.empty((sums.shape[0], 4))
    steepest = np.sin(angle)
    for index in order:
        x, y, ux, uy = middles[index, 0], middles[index, 1], ways[index, 0], ways[index, 1]
        best = -1
        least = 1.0
        for g in range(count):
            if abs(uy * lines[g, 2] - ux * lines[g, 3]) > steepest:
                continue
            off = abs(lines[g, 2] * (y - lines[g, 1]) - lines[g, 3] * (x - lines[g, 0]))
            if off / distance < least:
                least = off / distance
                best = g
        if best < 0:
            if lengths[index] < long or count == sums.shape[0]:
                continue
            best = count
            count += 1
            least = 0.0
        length = lengths[index]
        labels[index] = best
        own = sums[best]
        own[0] += length
        own[1] += length * x
        own[2] += length * y
        own[3] += length * (ux * ux - uy * uy)
        own[4] += length * 2.0 * ux * uy
        own[5] += length * (1.0 - least)
        direction = 0.5 * np.arctan2(own[4], own[3])
        lines[best, 0], lines[best, 1] = own[1] / own[0], own[2] / own[0]
        lines[best, 2], lines[best, 3] = np.cos(direction), np.sin(direction)
    return count


def form_groups(
    segments: Float32Array,
    centre: tuple[float, float],
    distance: float,
    angle: float,
    long: float,
    most: int = 256,
) -> list[Group]:
    """Sort segments into groups near in direction and position, the heaviest first (4.2.2).

    Segments are taken from the longest down. A long one that fits no group starts one; the line of
    a group is the length-weighted mean of its segments and follows each that joins.

    Args:
        segments: (N, 4) float32, px.
        centre: the picture's centre, x y, px.
        distance: R, px.
        angle: A, rad.
        long: least length of a segment that starts a group, px.
        most: groups at most.
    """
    if segments.shape[0] == 0:
        return []
    ends = segments.astype(np.float64)
    middles = 0.5 * (ends[:, :2] + ends[:, 2:]) - np.array(centre)
    across = ends[:, 2:] - ends[:, :2]
    lengths = np.hypot(across[:, 0], across[:, 1])
    ways = across / np.maximum(lengths, 1e-9)[:, None]
    order = np.argsort(-lengths, kind="stable")
    labels = np.full(len(ends), -1, np.int64)
    sums = np.zeros((most, 6))
    count = _assign(middles, ways, lengths, order, distance, angle, long, labels, sums)
    sums = sums[:count]
    theta = 0.5 * np.arctan2(sums[:, 4], sums[:, 3]) + np.pi / 2
    rho = (sums[:, 1] * np.cos(theta) + sums[:, 2] * np.sin(theta)) / sums[:, 0]
    by_group = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[by_group], np.arange(count + 1))
    return [
        Group(
            (float(theta[g]), float(rho[g])), float(sums[g, 5]), by_group[starts[g] : starts[g + 1]]
        )
        for g in np.argsort(-sums[:, 5], kind="stable")
    ]
