"""Triangle meshes of the pipe and of height fields.

Cells of a grid are cut in two triangles in a fixed order, so that the surface coordinates of a hit
follow from its triangle's number and its barycentric coordinates alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.axis import PipeAxis

Array = NDArray[np.float64]

# Around the pipe; with the mean radius kept, its silhouette is true to 2e-5 of the radius.
TUBE_FACETS = 256
# Along the pipe, m.
TUBE_STEP = 0.05


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (V, 3) float32, m, world; faces (F, 3) int32."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class TubeFrames:
    """The axis at the tube mesh's sections: what shading needs of it.

    Attributes:
        start, step: chainage of section 0 and between sections, m.
        centre, right, up: (S, 3), world.
    """

    start: float
    step: float
    centre: Array
    right: Array
    up: Array


def grid_faces(rows: int, columns: int, closed: bool = False) -> NDArray[np.int32]:
    """Cut a grid of vertices into triangles.

    Args:
        rows, columns: number of vertices each way; vertex (i, j) has the number i * columns + j.
        closed: the last column is joined to the first.

    Returns:
        Faces (2 * cells, 3): of cell n the faces 2 n = (00, 10, 11) and 2 n + 1 = (00, 11, 01).
    """
    i = np.arange(rows - 1, dtype=np.int32)[:, None]
    j = np.arange(columns if closed else columns - 1, dtype=np.int32)[None, :]
    k = (j + 1) % columns
    a, b = i * columns + j, (i + 1) * columns + j
    c, d = (i + 1) * columns + k, i * columns + k
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=-2)
    return np.ascontiguousarray(faces.reshape(-1, 3), dtype=np.int32)


def tube_mesh(axis: PipeAxis) -> tuple[Mesh, TubeFrames]:
    """Mesh the pipe's surface.

    Column j of a section is at the angle 2 pi j / TUBE_FACETS from the top towards the right of
    travel. The vertices lie a trifle outside the true radius, so that the polygon's mean half
    width seen from any side is the radius.
    """
    count = int(np.ceil((axis.end - axis.start) / TUBE_STEP)) + 1
    s = np.linspace(axis.start, axis.end, count)
    _, right, up = axis.frames(s)
    centre = axis.points(s)
    angle = 2.0 * np.pi * np.arange(TUBE_FACETS) / TUBE_FACETS
    half_facet = np.pi / TUBE_FACETS
    reach = axis.radius * half_facet / np.sin(half_facet)
    around = np.cos(angle)[:, None] * up[:, None, :] + np.sin(angle)[:, None] * right[:, None, :]
    vertices = centre[:, None, :] + reach * around
    mesh = Mesh(
        vertices.reshape(-1, 3).astype(np.float32), grid_faces(count, TUBE_FACETS, closed=True)
    )
    return mesh, TubeFrames(float(s[0]), float(s[1] - s[0]), centre, right, up)
