"""Cables, further pipes and ledges of rock that lie on the bed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import grey_closing

from pipeline_tracker.simulation.axis import PipeAxis, Wander
from pipeline_tracker.simulation.bed import Bed
from pipeline_tracker.simulation.meshes import grid_faces
from pipeline_tracker.simulation.object_models import LedgeModel, TubeModel
from pipeline_tracker.simulation.pieces import Piece, smooth_normals, tube

Array = NDArray[np.float64]

# Spacing of a tube's rings, in its diameters and at most in metres.
_RING, _LONGEST = 0.8, 0.05
# A tube bends no more than to a radius of so many of its diameters, and hangs at most so deep, m.
_STIFF, _DEEPEST = 25.0, 0.6
# A ledge reaches this far into the bed, m, and its surface is this rough.
_ROOT, _ROUGH = 0.5, 0.012
_UP = np.array([0.0, 0.0, 1.0])


def tube_on_bed(
    model: TubeModel,
    axis: PipeAxis,
    bed: Bed,
    rng: np.random.Generator,
    *,
    present: bool,
    material: int,
) -> Piece:
    """Lay a cable or a pipe on the bed.

    Args:
        model: what it is like.
        axis: the pipe's axis, for its place.
        bed: what it lies on.
        rng: random numbers for its windings.
        present: there is a pipe at the axis, to lie on.
        material: number of its material.
    """
    radius = model.diameter / 2.0
    step = min(_RING * model.diameter, _LONGEST)
    way = np.linspace(-model.length / 2.0, model.length / 2.0, 1 + int(model.length / step))
    winding = Wander.draw(rng, model.wave, model.wave_length)(way)
    turn = np.deg2rad(model.angle_deg)
    s = model.at + way * np.cos(turn) - winding * np.sin(turn)
    aside = model.offset + way * np.sin(turn) + winding * np.cos(turn)
    known = (s > axis.start) & (s < axis.end)
    s, aside = s[known], aside[known]
    line: Array = axis.points(s) - axis.frames(s)[1] * aside[:, None]
    line[:, 2] = bed.height_at(line) + radius * (1.0 - 2.0 * model.burial)
    if present and model.over:
        nearest, side = axis.nearest(line)
        reach = axis.radius + radius
        top = np.sqrt(np.maximum(reach**2 - side**2, 0.0))
        above = np.abs(side) < reach
        line[above, 2] = np.maximum(line[:, 2], axis.points(nearest)[:, 2] + top)[above]
    line[:, 2] = _stiff(line[:, 2], step, _STIFF * model.diameter)
    return tube(line, radius, 24 if radius < 0.05 else 64, material)


def _stiff(heights: Array, step: float, radius: float) -> Array:
    """Lift a tube out of hollows that it is too stiff to follow."""
    half = int(np.ceil(np.sqrt(2.0 * radius * _DEEPEST) / step))
    x = step * np.arange(-half, half + 1)
    lifted: Array = grey_closing(heights, structure=-(x**2) / (2.0 * radius), mode="nearest")
    return lifted


def ledge_on_bed(
    model: LedgeModel, axis: PipeAxis, bed: Bed, rng: np.random.Generator, material: int
) -> list[Piece]:
    """Lay a slab of rock on the bed: its steep face, its top and its two ends.

    Args:
        model: what it is like.
        axis: the pipe's axis, for its place.
        bed: what it lies on; the edge is straight, whatever the bed does.
        rng: random numbers for its roughness.
        material: number of its material.
    """
    tangent, right, _ = (vector[0] for vector in axis.frames(np.array([model.at])))
    middle = axis.points(model.at) - right * model.offset
    level = np.array([tangent[0], tangent[1], 0.0]) / np.hypot(tangent[0], tangent[1])
    turn = np.deg2rad(model.angle_deg)
    along = np.cos(turn) * level + np.sin(turn) * np.cross(_UP, level)
    port = np.cross(_UP, along)
    t = np.linspace(-model.length / 2.0, model.length / 2.0, 2 + int(model.length / 0.05))
    foot = middle + t[:, None] * along
    slope, height = np.polyfit(t, bed.height_at(foot), 1)
    foot[:, 2] = height + slope * t
    edge = foot + model.height * _UP
    across = np.linspace(0.0, 1.0, 24)
    drop = (model.height + _ROOT) * across**2.5
    # Narrower towards its ends, with a ragged border behind.
    shape = np.sqrt(np.maximum(0.0, 1.0 - (2.0 * t / model.length) ** 2))
    ragged = Wander.draw(rng, 0.25, 1.3)(t) + Wander.draw(rng, 0.10, 0.35)(t)
    width = model.width * np.maximum(0.1, (0.15 + 0.85 * shape) * (1.0 + ragged))
    top = edge + across[:, None, None] * width[:, None] * port - drop[:, None, None] * _UP
    rough = rng.standard_normal(top.shape[:2])
    rough = (rough + np.roll(rough, 1, 0) + np.roll(rough, 1, 1)) / np.sqrt(3.0)
    top[..., 2] += _ROUGH * np.minimum(1.0, 4.0 * across)[:, None] * rough
    front = np.stack([foot - _ROOT * _UP + 0.05 * port, edge])
    pieces = [_sheet(front, -port, model, material), _sheet(top, _UP, model, material)]
    for n, outward in ((0, -along), (-1, along)):
        below = np.broadcast_to(top[-1, n], top[:, n].shape)
        pieces.append(_sheet(np.stack([top[:, n], below]), outward, model, material))
        pieces.append(_sheet(np.stack([front[:, n], below[:2]]), outward, model, material))
    return pieces


def _sheet(grid: Array, towards: Array, model: LedgeModel, material: int) -> Piece:
    """Return a grid of places (R, C, 3) as a piece that shows the side of ``towards``."""
    rows, columns = grid.shape[:2]
    vertices, faces = grid.reshape(-1, 3), grid_faces(rows, columns)
    down = np.linspace(0.0, model.width, rows)[:, None]
    along = np.linspace(0.0, model.length, columns)[None, :]
    coordinates = np.stack(np.broadcast_arrays(along, down), axis=-1).reshape(-1, 2)
    return Piece(vertices, faces, smooth_normals(vertices, faces, towards), coordinates, material)
