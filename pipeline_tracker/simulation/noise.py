"""Procedural noise: the same number for the same place, seed and machine.

All textures are band-limited by the size of a pixel on the surface (``footprint``), so that one
ray a pixel shows no aliasing and both cameras see the same texture.
"""

from __future__ import annotations

import numpy as np

from pipeline_tracker.jit import compiled_sums


@compiled_sums
def lattice_hash(ix: int, iy: int, seed: int) -> int:
    """Mix two lattice coordinates and a seed to 32 evenly spread bits."""
    h = (ix * 0x27D4EB2D + iy * 0x165667B1 + seed * 0x1E3779B9) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    h = ((h ^ (h >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return h ^ (h >> 15)


@compiled_sums
def _corner(ix: int, iy: int, wrap: int, seed: int) -> tuple[float, float]:
    """Return the gradient of one lattice point, each part -1 to 1."""
    if wrap > 0:
        iy = iy % wrap
    h = lattice_hash(ix, iy, seed)
    return (h & 0xFFFF) / 32767.5 - 1.0, (h >> 16) / 32767.5 - 1.0


@compiled_sums
def gradient_noise(x: float, y: float, wrap: int, seed: int) -> tuple[float, float, float]:
    """Return smooth noise with a lattice of 1, and its derivatives by x and y.

    Args:
        x, y: place, in cells.
        wrap: y repeats after this many cells; 0: never.
        seed: which noise.

    Returns:
        Value (about -1 to 1, rms 0.3) and derivatives.
    """
    ix = int(np.floor(x))
    iy = int(np.floor(y))
    fx = x - ix
    fy = y - iy
    ux = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0)
    uy = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
    dux = 30.0 * fx * fx * (fx - 1.0) * (fx - 1.0)
    duy = 30.0 * fy * fy * (fy - 1.0) * (fy - 1.0)
    ax, ay = _corner(ix, iy, wrap, seed)
    bx, by = _corner(ix + 1, iy, wrap, seed)
    cx, cy = _corner(ix, iy + 1, wrap, seed)
    dx, dy = _corner(ix + 1, iy + 1, wrap, seed)
    a = ax * fx + ay * fy
    b = bx * (fx - 1.0) + by * fy
    c = cx * fx + cy * (fy - 1.0)
    d = dx * (fx - 1.0) + dy * (fy - 1.0)
    low = a + ux * (b - a)
    high = c + ux * (d - c)
    value = low + uy * (high - low)
    low_x = ax + ux * (bx - ax) + dux * (b - a)
    high_x = cx + ux * (dx - cx) + dux * (d - c)
    low_y = ay + ux * (by - ay)
    high_y = cy + ux * (dy - cy)
    by_x = low_x + uy * (high_x - low_x)
    by_y = low_y + uy * (high_y - low_y) + duy * (high - low)
    return 1.7 * value, 1.7 * by_x, 1.7 * by_y


@compiled_sums
def fractal_noise(
    x: float,
    y: float,
    length: float,
    octaves: int,
    gain: float,
    footprint: float,
    wrap: int,
    seed: int,
) -> tuple[float, float, float]:
    """Sum octaves of noise, each half as long and ``gain`` as strong as the one before.

    Args:
        x, y: place, m.
        length: wave length of the first octave, m.
        octaves: how many.
        gain: strength of the next octave relative to this one.
        footprint: size of a pixel there, m; octaves that it cannot show fade out.
        wrap: y repeats after this many first-octave cells; 0: never.
        seed: which noise.

    Returns:
        Value (rms about 0.3 of the root of the strengths' sum of squares) and its derivatives by x
        and y in 1/m.
    """
    value = 0.0
    by_x = 0.0
    by_y = 0.0
    strength = 1.0
    for k in range(octaves):
        # Nothing of an octave below two pixels, all of it from four pixels on.
        fade = min(1.0, (length / footprint - 2.0) * 0.5)
        if fade <= 0.0:
            break
        v, vx, vy = gradient_noise(x / length, y / length, wrap, seed + 7919 * k)
        value += fade * strength * v
        by_x += fade * strength * vx / length
        by_y += fade * strength * vy / length
        length *= 0.5
        wrap *= 2
        strength *= gain
    return value, by_x, by_y


@compiled_sums
def spots(
    x: float, y: float, cell: float, density: float, footprint: float, wrap: int, seed: int
) -> tuple[float, float, float, float]:
    """Round spots (pebbles, barnacles), at most one in each cell of a lattice.

    Args:
        x, y: place, m.
        cell: size of a cell, m; a spot's radius is 0.12 to 0.4 of it.
        density: share of cells with a spot, 0 to 1.
        footprint: size of a pixel there, m: the spot's border is at least this soft.
        wrap: y repeats after this many cells; 0: never.
        seed: which spots.

    Returns:
        Cover 0 to 1 (soft border), the direction from the spot's centre in radii (x, y), and a
        random number 0 to 1 of this spot.
    """
    ix = int(np.floor(x / cell))
    iy = int(np.floor(y / cell))
    h = lattice_hash(ix, iy % wrap if wrap > 0 else iy, seed)
    if (h & 0xFF) >= 256.0 * density:
        return 0.0, 0.0, 0.0, 0.0
    radius = 0.12 + 0.28 * (((h >> 8) & 0xFF) / 255.0) ** 2
    cx = radius + (1.0 - 2.0 * radius) * ((h >> 16) & 0xFF) / 255.0
    cy = radius + (1.0 - 2.0 * radius) * ((h >> 24) & 0xFF) / 255.0
    dx = (x / cell - ix - cx) / radius
    dy = (y / cell - iy - cy) / radius
    softness = max(0.25, 1.5 * footprint / (radius * cell))
    cover = (1.0 - np.sqrt(dx * dx + dy * dy)) / softness
    # A spot smaller than a pixel fades instead of flickering.
    strength = min(1.0, radius * cell / footprint)
    return min(1.0, max(0.0, cover)) * strength, dx, dy, ((h * 2654435761) >> 7 & 0xFF) / 255.0
