"""Modified Hough transform: votes come from segments, not pixels (4.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled
from pipeline_tracker.types import Float32Array

Array = NDArray[np.float64]

# Cells of the table over half a turn.
_ANGLE_CELLS = 180


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
    table: Float32Array,
) -> None:
    """Add each segment's contribution to the cells (θ, ρ) of the lines it may belong to.

    θ runs over half a turn; (ρ, θ) and (-ρ, θ + π) are one line, so that a bundle which leaves the
    table at one end comes in at the other with the sign of ρ turned.
    """
    angle_cells, rho_cells = table.shape
    half = (rho_cells - 1) // 2
    reach = int(spread / angle_step)
    directions = np.empty((angle_cells, 2))
    for j in range(angle_cells):
        directions[j, 0], directions[j, 1] = np.cos(j * angle_step), np.sin(j * angle_step)
    for i in range(middles.shape[0]):
        x, y = lengths[i] * np.cos(normals[i]), lengths[i] * np.sin(normals[i])
        first = int(np.rint(normals[i] / angle_step))
        for j in range(first - reach, first + reach + 1):
            cell = j % angle_cells
            c, s = directions[cell, 0], directions[cell, 1]
            along = abs(c * x + s * y)
            rho = middles[i, 0] * c + middles[i, 1] * s
            low = max(int(np.ceil((rho - distance) / rho_step)), -half)
            high = min(int(np.floor((rho + distance) / rho_step)), half)
            for k in range(low, high + 1):
                table[cell, half + k] += along * (1.0 - abs(k * rho_step - rho) / distance)


@compiled
def _highest(table: Float32Array, row: int, heights: Array, columns: NDArray[np.int64]) -> None:
    """Find the heaviest cell of a row anew."""
    column = 0
    for r in range(1, table.shape[1]):
        if table[row, r] > table[row, column]:
            column = r
    heights[row] = table[row, column]
    columns[row] = column


@compiled
def _peaks(
    table: Float32Array,
    least: float,
    angle_reach: int,
    rho_reach: int,
    out: NDArray[np.int64],
    weights: Array,
) -> int:
    """Take the heaviest cell, clear its neighbourhood (round the wrap as well), and so on.

    Args:
        table: changed.
        least: weight that a cell must have more of.
        angle_reach, rho_reach: of a neighbourhood, cells.
        out, weights: (most, 2) and (most,), filled with rows and columns of the cells, and what
            was in them.

    Returns:
        How many are found.
    """
    angle_cells, rho_cells = table.shape
    half = (rho_cells - 1) // 2
    heights, columns = np.empty(angle_cells), np.empty(angle_cells, np.int64)
    for a in range(angle_cells):
        _highest(table, a, heights, columns)
    count = 0
    while count < out.shape[0]:
        row = int(np.argmax(heights))
        column = columns[row]
        if not heights[row] > least:
            break
        out[count, 0] = row
        out[count, 1] = column
        weights[count] = heights[row]
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
            _highest(table, a, heights, columns)
    return count


@compiled
def _refine(
    middles: Array,
    ways: Array,
    lengths: Array,
    theta: float,
    rho: float,
    distance: float,
    spread: float,
) -> tuple[float, float]:
    """Move a line to the weighted least squares of the segments that vote for it."""
    steepest = np.sin(spread)
    for _ in range(3):
        total = 0.0
        sx = 0.0
        sy = 0.0
        xx = 0.0
        xy = 0.0
        yy = 0.0
        c, s = np.cos(theta), np.sin(theta)
        for i in range(middles.shape[0]):
            off = abs(middles[i, 0] * c + middles[i, 1] * s - rho)
            if off > distance or abs(ways[i, 0] * c + ways[i, 1] * s) > steepest:
                continue
            w = lengths[i] * (1.0 - off / distance)
            dx = 0.5 * lengths[i] * ways[i, 0]
            dy = 0.5 * lengths[i] * ways[i, 1]
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
    lines, weights = np.empty((most, 3)), np.empty(most)
    count = _find(
        np.ascontiguousarray(segments, np.float32),
        *size,
        spread,
        distance,
        least_share,
        lines,
        weights,
    )
    return [HoughLine(lines[k], float(weights[k])) for k in range(count)]


@compiled
def _find(
    segments: Float32Array,
    width: int,
    height: int,
    spread: float,
    distance: float,
    least_share: float,
    lines: Array,
    weights: Array,
) -> int:
    """Fill lines, (most, 3), and weights, (most,), see ``hough_lines``; how many there are."""
    n = segments.shape[0]
    cx, cy = (width - 1) / 2, (height - 1) / 2
    middles, ways, lengths, normals = np.empty((n, 2)), np.empty((n, 2)), np.empty(n), np.empty(n)
    for i in range(n):
        x1, y1 = np.float64(segments[i, 0]), np.float64(segments[i, 1])
        x2, y2 = np.float64(segments[i, 2]), np.float64(segments[i, 3])
        middles[i, 0], middles[i, 1] = 0.5 * (x1 + x2) - cx, 0.5 * (y1 + y2) - cy
        dx, dy = x2 - x1, y2 - y1
        lengths[i] = np.sqrt(dx * dx + dy * dy)
        scale = 1.0 / max(lengths[i], 1e-9)
        ways[i, 0], ways[i, 1] = dx * scale, dy * scale
        normals[i] = (np.arctan2(dy, dx) + 0.5 * np.pi) % np.pi
    angle_step = np.pi / _ANGLE_CELLS
    rho_step = distance / 3.0
    half = int(0.5 * np.sqrt(width * width + height * height) / rho_step) + 4
    table = np.zeros((_ANGLE_CELLS, 2 * half + 1), np.float32)
    _vote(middles, normals, lengths, angle_step, rho_step, spread, distance, table)
    cells = np.empty((lines.shape[0], 2), np.int64)
    count = _peaks(table, least_share * min(width, height), 3, 5, cells, weights)
    for k in range(count):
        theta, rho = cells[k, 0] * angle_step, (cells[k, 1] - half) * rho_step
        theta, rho = _refine(middles, ways, lengths, theta, rho, distance, spread)
        lines[k, 0], lines[k, 1] = np.cos(theta), np.sin(theta)
        lines[k, 2] = -rho - lines[k, 0] * cx - lines[k, 1] * cy
    return count
