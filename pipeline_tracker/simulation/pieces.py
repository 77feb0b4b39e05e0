"""Pieces of surface from which things in the sea are put together.

A piece carries what shading needs at each of its vertices: normal, surface coordinates, and the
number of its material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.landing import FIRST_THING, MeshData
from pipeline_tracker.simulation.meshes import Mesh, grid_faces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """A piece of surface.

    Attributes:
        vertices: (V, 3), m.
        faces: (F, 3).
        normals: (V, 3), unit.
        coordinates: (V, 2), what the material's texture goes by.
        material: number of the material.
        thin: it has two sides, and shows the one that is looked at.
    """

    vertices: Array
    faces: NDArray[np.int32]
    normals: Array
    coordinates: Array
    material: int
    thin: bool = False

    def moved(self, rotation: Array, place: Array) -> Piece:
        """Return it turned (3 x 3) and then shifted (3,)."""
        return replace(
            self,
            vertices=self.vertices @ rotation.T + place,
            normals=self.normals @ rotation.T,
        )


def merged(pieces: Sequence[Piece]) -> tuple[Mesh, MeshData]:
    """Put pieces together to one mesh, and to what shading needs of it."""
    counts = [len(piece.vertices) for piece in pieces]
    starts = np.cumsum([0, *counts])[:-1]
    faces = [p.faces + start for p, start in zip(pieces, starts, strict=True)]
    whole = np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32)

    def joined(parts: list[Array], width: int) -> NDArray[np.float32]:
        return np.concatenate([np.zeros((0, width)), *parts]).astype(np.float32)

    data = MeshData(
        whole,
        joined([p.normals for p in pieces], 3),
        joined([p.coordinates for p in pieces], 2),
        np.repeat([FIRST_THING + p.material for p in pieces], counts).astype(np.int8),
        np.repeat([p.thin for p in pieces], counts).astype(np.bool_),
    )
    return Mesh(joined([p.vertices for p in pieces], 3), whole), data


def smooth_normals(vertices: Array, faces: NDArray[np.int32], towards: Array) -> Array:
    """Return unit normals (V, 3), each the mean of its faces', on the side of ``towards`` (3,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    of_faces = np.cross(b - a, c - a)
    of_faces *= np.where(of_faces @ towards < 0.0, -1.0, 1.0)[:, None]
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], of_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


def tube(line: Array, radius: float, facets: int, material: int) -> Piece:
    """Return a closed round tube along a line.

    Args:
        line: (N, 3) points, nowhere upright, m.
        radius: m.
        facets: around it.
        material: number of the material; its coordinates are the way along and around, m.
    """
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    right = np.cross(tangent, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(right, tangent)
    angle = 2.0 * np.pi * np.arange(facets) / facets
    # As for the pipe: the mean half width is the radius.
    reach = radius * (np.pi / facets) / np.sin(np.pi / facets)
    out = np.cos(angle)[:, None] * up[:, None] + np.sin(angle)[:, None] * right[:, None]
    rings = line[:, None] + reach * out
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    coordinates = np.stack(np.broadcast_arrays(along[:, None], radius * angle[None, :]), axis=-1)
    # Flat ends: a point and a ring with the normal of the end.
    ends = [np.broadcast_to(sign * tangent[n], (2, facets, 3)) for sign, n in ((-1, 0), (1, -1))]
    caps = [np.stack([np.broadcast_to(line[n], rings[n].shape), rings[n]]) for n in (0, -1)]
    vertices = np.concatenate([caps[0], rings, caps[1][::-1]])
    normals = np.concatenate([ends[0], out, ends[1]])
    grown = np.concatenate([coordinates[[0, 0]], coordinates, coordinates[[-1, -1]]])
    return Piece(
        vertices.reshape(-1, 3),
        grid_faces(len(vertices), facets, closed=True),
        normals.reshape(-1, 3),
        grown.reshape(-1, 2),
        material,
    )
