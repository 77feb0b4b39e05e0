"""Embree behind a small typed class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.extra import embree_modules
from pipeline_tracker.simulation.meshes import Mesh

Float32Array = NDArray[np.float32]


class Hits(NamedTuple):
    """Nearest hits of N rays.

    Attributes:
        mesh: (N,) int32, the mesh's number, -1 where nothing was hit.
        face: (N,) int32, number of the triangle.
        u, v: (N,) float32, barycentric weights of the triangle's second and third vertex.
        distance: (N,) float32, in lengths of the ray's direction.
    """

    mesh: NDArray[np.int32]
    face: NDArray[np.int32]
    u: Float32Array
    v: Float32Array
    distance: Float32Array


class Caster(Protocol):
    """Something to cast rays at."""

    def nearest(self, origins: Float32Array, directions: Float32Array) -> Hits:
        """Return what rays (N, 3) hit first."""

    def blocked(self, origins: Float32Array, directions: Float32Array) -> NDArray[np.bool_]:
        """Return whether anything is hit between ``origins`` and ``origins + directions``, (N,)."""


@dataclass(frozen=True)
class BothCasters:
    """Two scenes in one: what stays, and what is somewhere else at another time."""

    still: Caster
    moving: Caster

    def nearest(self, origins: Float32Array, directions: Float32Array) -> Hits:
        """Return what rays (N, 3) hit first."""
        still = self.still.nearest(origins, directions)
        moving = self.moving.nearest(origins, directions)
        nearer = (moving.mesh >= 0) & ((still.mesh < 0) | (moving.distance < still.distance))
        return Hits(*(np.where(nearer, m, s) for s, m in zip(still, moving, strict=True)))

    def blocked(self, origins: Float32Array, directions: Float32Array) -> NDArray[np.bool_]:
        """Return whether anything is hit between ``origins`` and ``origins + directions``, (N,)."""
        return self.still.blocked(origins, directions) | self.moving.blocked(origins, directions)


class RayCaster:
    """Casts rays at triangle meshes. May be used by several threads at once."""

    def __init__(self, meshes: Mapping[int, Mesh]) -> None:
        """Build the scene.

        Args:
            meshes: what can be hit, by the number that ``Hits.mesh`` tells. None is empty.

        Raises:
            PipelineTrackerError: embreex is not installed.
        """
        scenes, construction = embree_modules()
        self._scene: Any = scenes.EmbreeScene()
        # Behind the last one's number the one for nothing, which Embree counts as -1.
        self._numbers = np.array([*meshes, -1], np.int32)
        for mesh in meshes.values():
            construction.TriangleMesh(self._scene, mesh.vertices, mesh.faces)
        # The first query commits the scene; afterwards it is read only.
        self.nearest(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def nearest(self, origins: Float32Array, directions: Float32Array) -> Hits:
        """Return what rays (N, 3) hit first."""
        result = self._scene.run(origins, directions, query="INTERSECT", output=1)
        mesh = self._numbers[result["geomID"]]
        return Hits(mesh, result["primID"], result["u"], result["v"], result["tfar"])

    def blocked(self, origins: Float32Array, directions: Float32Array) -> NDArray[np.bool_]:
        """Return whether anything is hit between ``origins`` and ``origins + directions``, (N,)."""
        reach = np.ones(len(origins), np.float32)
        result = self._scene.run(origins, directions, reach, query="OCCLUDED")
        blocked: NDArray[np.bool_] = result >= 0
        return blocked
