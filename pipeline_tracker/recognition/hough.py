"""Modified Hough transform: votes come from segments, not pixels (4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HoughLine:
    """A line found in an image.

    Attributes:
        line: homogeneous (a, b, c), a² + b² = 1, px of the image.
        weight: sum of contributions of the segments along it, px.
    """

    line: Array
    weight: float


@compiled
def _vote(
    middles: Array,
    normals: Array,
    lengths: Array,
    angle_step: float,
    rho_step: float,
    spread: float,
    distance: float,
    table: Array,
) -> None:
    """Add each segment's contribution to the cells (θ, ρ) of the lines it may belong to.

    θ runs over half a turn; (ρ, θ) and (-ρ, θ + π) are one line, so that a bundle which leaves the
    table at one end comes in at the other with the sign of ρ turned.
    """
    angle_cells, rho_cells = table.shape
    half = (rho_cells - 1) // 2
    reach = int(spread / angle_step)
    for i in range(middles.shape[0]):
        first = int(np.rint(normals[i] / angle_step))
        for j in range(first - reach, first + reach + 1):
            theta = j * angle_step
            turn = theta - normals[i]
            along = lengths[i] * np.cos(turn)
            rho = middles[i, 0] * np.cos(theta) + middles[i, 1] * np.sin(theta)
            cell = j % angle_cells
            # How often the angle went round: each half turn changes the sign of rho.
            sign = 1.0 if ((j - cell) // angle_cells) % 2 == 0 else -1.0
            low = int(np.ceil((rho - distance) / rho_step))
            high = int(np.floor((rho + distance) / rho_step))
            for k in range(low, high + 1):
                weight = along * (1.0 - abs(k * rho_step - rho) / distance)
                column = half + int(sign) * k
                if 0 <= column < rho_cells:
                    table[cell, column] += weight


@compiled
def _peaks(
    table: Array, most: int, least: float, angle_reach: int, rho_reach: int, out: NDArray[np.int64]
) -> int:
    """Take the heaviest cell, clear its neighbourhood (round the wrap as well), and so on."""
    angle_cells, rho_cells = table.shape
    half = (rho_cells - 1) // 2
    count = 0
    while count < most:
        best = least
        row = -1
        column = -1
        for a in range(angle_cells):
            for r in range(rho_cells):
                if table[a, r] > best:
                    best = table[a, r]
                    row = a
                    column = r
        if row < 0:
            break
        out[count, 0] = row
        out[count, 1] = column
        count += 1
        for da in range(-angle_reach, angle_reach + 1):
            a = row + da
            sign = 1
            if a < 0 or a >= angle_cells:
                a %= angle_cells
                sign = -1
            centre = half + sign * (column - half)
            for dr in range(-rho_reach, rho_reach + 1):
                r = centre + dr
                if 0 <= r < rho_cells:
                    table[a, r] = 0.0
    return count


@compiled
def _refine(
    middles: Array,
    angles: Array,
    lengths: Array,
    theta: float,
    rho: float,
    distance: float,
    spread: float,
) -> tuple[float, float]:
    """Move a line to the weighted least squares of the segments that vote for it."""
    for _ in range(3):
        total = 0.0
        sx = 0.0
        sy = 0.0
        c2 = 0.0
        s2 = 0.0
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for i in range(middles.shape[0]):
            off = abs(middles[i, 0] * np.cos(theta) + middles[i, 1] * np.sin(theta) - rho)
            if off > distance or abs(np.cos(angles[i] - theta)) > np.sin(spread):
                continue
            w = lengths[i] * (1.0 - off / distance)
            dx = 0.5 * lengths[i] * np.cos(angles[i])
            dy = 0.5 * lengths[i] * np.sin(angles[i])
            total += w
            sx += w * middles[i, 0]
            sy += w * middles[i, 1]
            # The segment counts with its whole length, not as a point.
            xx += w * (middles[i, 0] ** 2 + dx * dx / 3)
            xy += w * (middles[i, 0] * middles[i, 1] + dx * dy / 3)
            yy += w * (middles[i, 1] ** 2 + dy * dy / 3)
        if total <= 0.0:
            break
        mx = sx / total
        my = sy / total
        c2 = xx / total - mx * mx - (yy / total - my * my)
        s2 = 2.0 * (xy / total - mx * my)
        turned = 0.5 * np.arctan2(s2, c2) + np.pi / 2
        # Keep to the same sense of the normal.
        if np.cos(turned - theta) < 0:
            turned += np.pi
        theta = turned
        rho = mx * np.cos(theta) + my * np.sin(theta)
    return theta, rho


def hough_lines(
    segments: Float32Array,
    size: tuple[int, int],
    most: int = 12,
    spread: float = 0.07,
    distance: float = 6.0,
    least_share: float = 0.08,
) -> list[HoughLine]:
    """Find the lines that the segments of an image form (4.2.3), the heaviest first.

    Args:
        segments: (N, 4) float32, px.
        size: width and height of the image, px.
        most: lines at most.
        spread: φ, largest angle between a segment and its line, rad.
        distance: δ, largest distance of a segment's middle from its line, px.
        least_share: least weight of a line, as a share of the image's shorter side.

    Returns:
        The lines, each moved to the least squares of the segments that voted for it.
    """
    if segments.shape[0] == 0:
        return []
    width, height = size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    ends = segments.astype(np.float64)
    middles = 0.5 * (ends[:, :2] + ends[:, 2:]) - centre
    across = ends[:, 2:] - ends[:, :2]
    lengths = np.hypot(across[:, 0], across[:, 1])
    angles = np.arctan2(across[:, 1], across[:, 0])
    angle_cells = 180
    angle_step = np.pi / angle_cells
    rho_step = distance / 3.0
    half = int(np.hypot(width, height) / 2 / rho_step) + 4
    table = np.zeros((angle_cells, 2 * half + 1))
    normals = np.mod(angles + np.pi / 2, np.pi)
    _vote(middles, normals, lengths, angle_step, rho_step, spread, distance, table)
    cells = np.empty((most, 2), np.int64)
    least = least_share * min(width, height)
    count = _peaks(table.copy(), most, least, 3, 5, cells)
    lines = []
    for row, column in cells[:count]:
        theta, rho = _refine(
            middles, angles, lengths, row * angle_step, (column - half) * rho_step, distance, spread
        )
        normal = np.array([np.cos(theta), np.sin(theta)])
        line = np.array([normal[0], normal[1], -rho - float(normal @ centre)])
        lines.append(HoughLine(line, float(table[row, column])))
    return lines
