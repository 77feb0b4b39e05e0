"""What pipe, bed and stones look like: colour and small relief by place on the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled_sums
from pipeline_tracker.simulation.noise import fractal_noise, gradient_noise, spots

Array = NDArray[np.float64]
Rgb = tuple[float, float, float]


class PipeMaterial(NamedTuple):
    """The pipe's surface; see ``PipeModel``."""

    colour: Rgb
    texture: float
    growth: float
    damage: float
    sediment: float
    sediment_colour: Rgb
    joint_spacing: float
    circumference: float
    seed: int


class BedMaterial(NamedTuple):
    """The bed's surface; see ``BedModel``."""

    colour: Rgb
    texture: float
    seed: int


# Kinds of things: rock, cables and pipes; blades of weed; fish.
SOLID, BLADE, SCALES = 0.0, 1.0, 2.0


def thing_material(
    style: float,
    colour: Rgb,
    texture: float = 0.5,
    grain: float = 0.1,
    sediment: float = 0.0,
) -> tuple[float, ...]:
    """Return a row of the table of things' materials.

    Args:
        style: SOLID, BLADE or SCALES.
        colour: share of light returned.
        texture: contrast.
        grain: length of its coarsest texture, m.
        sediment: share of what faces up that is dusted.
    """
    return style, *colour, texture, grain, sediment


class Surface(NamedTuple):
    """Colour (share of light returned) and slopes of the small relief by the two coordinates."""

    red: float
    green: float
    blue: float
    slope_a: float
    slope_b: float


@compiled_sums
def _blend(low: float, high: float, value: float) -> float:
    """Return 0 below ``low``, 1 above ``high``, smooth between."""
    t = min(1.0, max(0.0, (value - low) / (high - low)))
    return t * t * (3.0 - 2.0 * t)


@compiled_sums
def _threshold(share: float) -> float:
    """Return about the value that noise of rms 0.4 exceeds on a share of all places."""
    return 0.7 * (1.0 - 2.0 * share)


@compiled_sums
def pipe_surface(
    along: float, around: float, upward: float, footprint: float, m: PipeMaterial
) -> Surface:
    """Return what the pipe looks like.

    Args:
        along: chainage, m.
        around: way around the pipe from its top towards the right of travel, m.
        upward: z of the surface's normal.
        footprint: size of a pixel there, m.
        m: the material.
    """
    around = around % m.circumference
    cell = m.circumference / 9.0
    mottle = fractal_noise(along, around, cell, 3, 0.6, footprint, 9, m.seed)
    fine = fractal_noise(along, around, cell / 4.0, 5, 0.85, footprint, 36, m.seed + 11)
    # Traces of handling, drawn out along the pipe.
    trace = fractal_noise(along / 6.0, around, cell / 4.0, 3, 0.8, footprint, 36, m.seed + 23)[0]
    light = 1.0 + m.texture * (0.6 * mottle[0] + 0.6 * fine[0] + 0.3 * trace)
    # Barnacles.
    cover, dx, dy, kind = spots(
        along, around, m.circumference / 60.0, 0.25, footprint, 60, m.seed + 31
    )
    light *= 1.0 + m.texture * cover * (2.4 * kind - 0.7)
    bump = 0.0025 * m.texture
    slope_a = bump * fine[1] - 0.4 * cover * dx
    slope_b = bump * fine[2] - 0.4 * cover * dy
    # A field joint: a smoother, darker sleeve with a line at each border.
    joint = abs((along / m.joint_spacing + 0.5) % 1.0 - 0.5) * m.joint_spacing
    sleeve = 1.0 - _blend(0.16, 0.16 + 2.0 * footprint, joint)
    line = 1.0 - _blend(0.006, 0.006 + 2.0 * footprint, abs(joint - 0.16))
    light *= (1.0 - 0.18 * sleeve) * (1.0 - 0.4 * line)
    red, green, blue = m.colour
    if m.damage > 0.0:
        # Patches without coating, their border sharp and ragged: dark steel, rust over most of it.
        ragged = fractal_noise(along, around, cell, 5, 0.6, footprint, 9, m.seed + 53)[0]
        edge = _threshold(m.damage) - 0.02
        soft = 0.01 + 4.0 * footprint
        bare = _blend(edge - soft, edge + soft, ragged)
        rim = bare * (1.0 - _blend(edge, edge + 0.05 + soft, ragged))
        rust = _blend(-0.35, 0.15, fine[0] + 0.5 * mottle[0]) * bare
        light *= 1.0 - 0.5 * bare * (1.0 - rust) + 0.3 * rim
        red += rust * (0.34 - red)
        green += rust * (0.17 - green)
        blue += rust * (0.08 - blue)
        slope_a -= 0.01 * rim * fine[1]
    # Growth in patches, darker and greener, and rust beside it.
    patch = mottle[0] + 0.5 * fine[0]
    edge = _threshold(m.growth)
    grown = _blend(edge, edge + 0.35, patch) if m.growth > 0.0 else 0.0
    light *= 1.0 - grown * (0.45 - 0.35 * fine[0])
    green += 0.05 * grown * m.colour[1]
    blue -= 0.30 * grown * m.colour[2]
    # Sediment stays on what faces up.
    dust = gradient_noise(along / 0.7, around / cell, 9, m.seed + 41)[0] + 0.6 * fine[0]
    edge = _threshold(m.sediment)
    dusted = _blend(edge, edge + 0.5, dust) * _blend(0.45, 0.95, upward)
    dusted = 0.8 * dusted if m.sediment > 0.0 else 0.0
    grain = 1.0 + 0.6 * m.texture * fine[0]
    light = max(0.08, light) * (1.0 - dusted)
    dusted *= grain
    return Surface(
        light * red + dusted * m.sediment_colour[0],
        light * green + dusted * m.sediment_colour[1],
        light * blue + dusted * m.sediment_colour[2],
        slope_a,
        slope_b,
    )


@compiled_sums
def bed_surface(x: float, y: float, footprint: float, m: BedMaterial) -> Surface:
    """Return what the bed looks like at a place (m), with a pixel of the given size (m)."""
    large = fractal_noise(x, y, 2.3, 4, 0.6, footprint, 0, m.seed)
    fine = fractal_noise(x, y, 0.16, 6, 0.85, footprint, 0, m.seed + 13)
    light = 1.0 + m.texture * (0.6 * large[0] + 0.6 * fine[0])
    # Gravel in patches: stronger contrast at small scale.
    gravel = gradient_noise(x / 1.4, y / 1.4, 0, m.seed + 29)[0] + 0.3 * large[0]
    gravel = _blend(0.15, 0.5, gravel)
    grit = (0.0, 0.0, 0.0)
    if gravel > 0.0:
        grit = fractal_noise(x, y, 0.05, 4, 0.9, footprint, 0, m.seed + 37)
    light *= 1.0 + 1.1 * m.texture * gravel * grit[0]
    slope_a = m.texture * (0.012 * fine[1] + 0.006 * gravel * grit[1])
    slope_b = m.texture * (0.012 * fine[2] + 0.006 * gravel * grit[2])
    for size, density, seed in ((0.11, 0.12, 43), (0.045, 0.10 + 0.3 * gravel, 47)):
        cover, dx, dy, kind = spots(x, y, size, density, footprint, 0, m.seed + seed)
        light *= 1.0 + m.texture * cover * (1.5 * kind - 0.9)
        slope_a -= 0.5 * cover * dx
        slope_b -= 0.5 * cover * dy
    light = max(0.08, light)
    # Films of algae.
    film = 0.5 * _blend(
        0.1, 0.6, gradient_noise(x / 0.9, y / 0.9, 0, m.seed + 53)[0] - 0.3 * fine[0]
    )
    return Surface(
        light * m.colour[0] * (1.0 - 0.45 * film),
        light * m.colour[1] * (1.0 - 0.15 * film),
        light * m.colour[2] * (1.0 - 0.50 * film),
        slope_a,
        slope_b,
    )


@compiled_sums
def stone_surface(
    x: float, y: float, z: float, brightness: float, footprint: float, m: BedMaterial
) -> Surface:
    """Return what a stone of the bed looks like at a place (m)."""
    fine = fractal_noise(x + 0.7 * z, y - 0.6 * z, 0.06, 5, 0.85, footprint, 0, m.seed + 61)
    light = brightness * max(0.1, 1.0 + m.texture * 0.9 * fine[0])
    grey = 0.75 * (m.colour[0] + m.colour[1] + m.colour[2]) / 3.0
    return Surface(
        light * grey, light * grey * 1.02, light * grey * 0.96, 0.008 * fine[1], 0.008 * fine[2]
    )


@compiled_sums
def thing_surface(
    a: float, b: float, upward: float, footprint: float, row: Array, bed: BedMaterial
) -> Surface:
    """Return what a thing looks like.

    Args:
        a, b: its coordinates: of a solid m, of a blade 0 (root) to 1 (tip) and a number of its own,
            of a fish the way from the nose in lengths and -1 (belly) to 1 (back).
        upward: z of the surface's normal.
        footprint: size of a pixel there, m.
        row: its material, see ``thing_material``.
        bed: the bed's material, for sediment on it.
    """
    style, red, green, blue, texture, grain, sediment = row
    light = 1.0
    slope_a = 0.0
    slope_b = 0.0
    dusted = 0.0
    if style == BLADE:
        light = (0.45 + 0.75 * a) * (0.6 + 0.8 * b)
        red *= 0.8 + 0.5 * b
    elif style == SCALES:
        # Dark above, bright below, with bars across.
        bars = gradient_noise(14.0 * a, 1.5 * b, 0, bed.seed + 71)[0]
        light = 0.75 - 0.45 * b * abs(b) - 0.25 * max(0.0, b) * bars
        # The eye.
        eye = (a - 0.09) ** 2 / 0.018**2 + (b - 0.35) ** 2 / 0.2**2
        light *= 0.15 + 0.85 * min(1.0, eye)
    else:
        coarse = fractal_noise(a, b, grain, 3, 0.7, footprint, 0, bed.seed + 73)
        fine = fractal_noise(a, b, 0.25 * grain, 4, 0.85, footprint, 0, bed.seed + 79)
        light = max(0.15, 1.0 + texture * (0.7 * coarse[0] + 0.7 * fine[0]))
        slope_a = 0.05 * texture * grain * (coarse[1] + 0.5 * fine[1])
        slope_b = 0.05 * texture * grain * (coarse[2] + 0.5 * fine[2])
        edge = _threshold(sediment)
        if sediment > 0.0:
            dust = coarse[0] + 0.5 * fine[0]
            dusted = 0.85 * _blend(edge, edge + 0.5, dust) * _blend(0.35, 0.9, upward)
    light *= 1.0 - dusted
    dusted *= 0.9
    return Surface(
        light * red + dusted * bed.colour[0],
        light * green + dusted * bed.colour[1],
        light * blue + dusted * bed.colour[2],
        slope_a,
        slope_b,
    )
