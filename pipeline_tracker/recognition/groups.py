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
    angles: Array,
    lengths: Array,
    order: NDArray[np.int64],
    distance: float,
    angle: float,
    long: float,
    labels: NDArray[np.int64],
    sums: Array,
) -> int:
    """Give each segment, longest first, to the nearest group or to one of its own.

    ``sums`` holds for each group: length, Σ l x, Σ l y, Σ l cos 2φ, Σ l sin 2φ, contributions.
    """
    count = 0
    for index in order:
        best = -1
        least = 1.0
        for g in range(count):
            x = sums[g, 1] / sums[g, 0]
            y = sums[g, 2] / sums[g, 0]
            direction = 0.5 * np.arctan2(sums[g, 4], sums[g, 3])
            turn = abs(np.sin(angles[index] - direction))
            if turn > np.sin(angle):
                continue
            off = abs(
                -np.sin(direction) * (middles[index, 0] - x)
                + np.cos(direction) * (middles[index, 1] - y)
            )
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
        sums[best, 0] += length
        sums[best, 1] += length * middles[index, 0]
        sums[best, 2] += length * middles[index, 1]
        sums[best, 3] += length * np.cos(2 * angles[index])
        sums[best, 4] += length * np.sin(2 * angles[index])
        sums[best, 5] += length * (1.0 - least)
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
    angles = np.arctan2(across[:, 1], across[:, 0])
    order = np.argsort(-lengths, kind="stable")
    labels = np.full(len(ends), -1, np.int64)
    sums = np.zeros((most, 6))
    count = _assign(middles, angles, lengths, order, distance, angle, long, labels, sums)
    groups = []
    for g in range(count):
        direction = 0.5 * np.arctan2(sums[g, 4], sums[g, 3])
        theta = direction + np.pi / 2
        rho = (sums[g, 1] * np.cos(theta) + sums[g, 2] * np.sin(theta)) / sums[g, 0]
        members = np.flatnonzero(labels == g)
        groups.append(Group((float(theta), float(rho)), float(sums[g, 5]), members))
    return sorted(groups, key=lambda group: -group.weight)
