"""From hits to places: what a ray met, and where on its smooth surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled_sums
from pipeline_tracker.simulation.raycaster import Hits

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Bytes = NDArray[np.int8]

# What a ray saw; these are also the numbers of the meshes for the ray caster.
NOTHING, PIPE, BED, STONE = -1, 0, 1, 2
# Of the meshes with things on and above the bed each triangle tells its own material: what a ray
# saw is this number and the material's.
FIRST_THING = 3
THINGS, MOVERS = 3, 4
# The first materials of things; those of objects on the bed follow.
TUFT, LUMP, FISH, FIRST_OBJECT = 0, 1, 2, 3


class Tube(NamedTuple):
    """The pipe for shading; see ``TubeFrames``."""

    start: float
    step: float
    facets: int
    radius: float
    centre: Array
    right: Array
    up: Array


class Ground(NamedTuple):
    """The bed for shading: border, spacing, slopes (X, Y, 2)."""

    x0: float
    y0: float
    resolution: float
    slopes: Float32Array


class MeshData(NamedTuple):
    """A mesh for shading: stones, or things put together from ``Piece``.

    Attributes:
        faces: (F, 3).
        normals: (V, 3), unit.
        coordinates: (V, 2), of the surface; a stone's brightness and 0.
        kinds: (V,), STONE, or FIRST_THING and more.
        thin: (V,), whether it shows the side that is looked at.
    """

    faces: NDArray[np.int32]
    normals: Float32Array
    coordinates: Float32Array
    kinds: Bytes
    thin: NDArray[np.bool_]


class Solids(NamedTuple):
    """All that can be hit, in the order of the meshes."""

    tube: Tube
    ground: Ground
    stones: MeshData
    things: MeshData
    movers: MeshData


class Landed(NamedTuple):
    """Where N rays landed.

    Attributes:
        kind: (N,) int8, NOTHING, PIPE, BED, STONE, or FIRST_THING and a thing's material.
        place: (N, 3), m, world.
        normal: (N, 3), unit, of the smooth surface.
        local: (N, 2): pipe: chainage and way around, m; bed: x and y, m; stone: brightness, 0;
            thing: its material's coordinates.
        distance: (N,), m; infinite where nothing was hit.
    """

    kind: Bytes
    place: Array
    normal: Array
    local: Array
    distance: Array


@compiled_sums
def sight_lines(sight: Array, rotation: Array) -> Float32Array:
    """Return unit directions (N, 3) in the world.

    Args:
        sight: x and y of the directions at z = 1 in the camera's frame, (N, 2).
        rotation: world <- camera, 3 x 3.
    """
    # Not as a matrix product: for three numbers BLAS wakes threads that cost more than they give.
    result = np.empty((sight.shape[0], 3), np.float32)
    for r in range(sight.shape[0]):
        x, y = sight[r, 0], sight[r, 1]
        norm = np.sqrt(x * x + y * y + 1.0)
        for k in range(3):
            result[r, k] = (rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]) / norm
    return result


@compiled_sums
def shadow_rays(landed: Landed, lamp: Array, lift: float) -> tuple[Float32Array, Float32Array]:
    """Return origins (N, 3), ``lift`` m above the places, and the ways from there to a lamp."""
    n = landed.kind.size
    origins = np.empty((n, 3), np.float32)
    ways = np.empty((n, 3), np.float32)
    for r in range(n):
        for k in range(3):
            start = landed.place[r, k] + lift * landed.normal[r, k]
            origins[r, k] = start
            ways[r, k] = lamp[k] - start
    return origins, ways


@compiled_sums
def _on_tube(tube: Tube, face: int, u: float, v: float) -> tuple[float, float, float, float, float]:
    """Return chainage, way around and normal of a hit on the pipe's mesh."""
    cell = face // 2
    i = cell // tube.facets
    j = cell - i * tube.facets
    if face % 2 == 0:
        fi, fj = u + v, v
    else:
        fi, fj = u, u + v
    angle = 2.0 * np.pi * (j + fj) / tube.facets
    c, s = np.cos(angle), np.sin(angle)
    n = np.empty(3)
    for k in range(3):
        up = tube.up[i, k] + fi * (tube.up[i + 1, k] - tube.up[i, k])
        right = tube.right[i, k] + fi * (tube.right[i + 1, k] - tube.right[i, k])
        n[k] = c * up + s * right
    n /= np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    return tube.start + tube.step * (i + fi), tube.radius * angle, n[0], n[1], n[2]


@compiled_sums
def _on_ground(ground: Ground, x: float, y: float) -> tuple[float, float, float]:
    """Return the bed's normal at a place."""
    slopes = ground.slopes
    px = (x - ground.x0) / ground.resolution
    py = (y - ground.y0) / ground.resolution
    i = min(max(int(px), 0), slopes.shape[0] - 2)
    j = min(max(int(py), 0), slopes.shape[1] - 2)
    fx, fy = px - i, py - j
    sx = 0.0
    sy = 0.0
    for a in range(2):
        for b in range(2):
            w = (fx if a else 1.0 - fx) * (fy if b else 1.0 - fy)
            sx += w * slopes[i + a, j + b, 0]
            sy += w * slopes[i + a, j + b, 1]
    norm = np.sqrt(1.0 + sx * sx + sy * sy)
    return -sx / norm, -sy / norm, 1.0 / norm


@compiled_sums
def _on_mesh(
    data: MeshData, face: int, u: float, v: float
) -> tuple[float, float, float, float, float]:
    """Return the normal and the surface coordinates of a hit on stones or things."""
    a, b, c = data.faces[face, 0], data.faces[face, 1], data.faces[face, 2]
    n, p, w = data.normals, data.coordinates, 1.0 - u - v
    nx = w * n[a, 0] + u * n[b, 0] + v * n[c, 0]
    ny = w * n[a, 1] + u * n[b, 1] + v * n[c, 1]
    nz = w * n[a, 2] + u * n[b, 2] + v * n[c, 2]
    norm = max(1e-9, np.sqrt(nx * nx + ny * ny + nz * nz))
    # As differences: what is the same at all three stays so to the last bit.
    first = p[a, 0] + u * (p[b, 0] - p[a, 0]) + v * (p[c, 0] - p[a, 0])
    second = p[a, 1] + u * (p[b, 1] - p[a, 1]) + v * (p[c, 1] - p[a, 1])
    return nx / norm, ny / norm, nz / norm, first, second


@compiled_sums
def land(hits: Hits, origin: Array, directions: Float32Array, solids: Solids) -> Landed:
    """Turn hits of unit rays from one origin into places on smooth surfaces."""
    mesh, face, u, v, distance = hits
    tube, ground, stones, things, movers = solids
    n = mesh.size
    kind = np.empty(n, np.int8)
    place = np.zeros((n, 3))
    normal = np.zeros((n, 3))
    local = np.zeros((n, 2))
    far = np.full(n, np.inf)
    for r in range(n):
        kind[r] = mesh[r]
        if mesh[r] < 0:
            continue
        far[r] = distance[r]
        for k in range(3):
            place[r, k] = origin[k] + far[r] * directions[r, k]
        if mesh[r] == PIPE:
            along, around, nx, ny, nz = _on_tube(tube, face[r], u[r], v[r])
            local[r, 0], local[r, 1] = along, around
        elif mesh[r] == BED:
            nx, ny, nz = _on_ground(ground, place[r, 0], place[r, 1])
            local[r, 0], local[r, 1] = place[r, 0], place[r, 1]
        else:
            data = stones if mesh[r] == STONE else things if mesh[r] == THINGS else movers
            first = data.faces[face[r], 0]
            kind[r] = data.kinds[first]
            nx, ny, nz, local[r, 0], local[r, 1] = _on_mesh(data, face[r], u[r], v[r])
            d = directions[r]
            if data.thin[first] and nx * d[0] + ny * d[1] + nz * d[2] > 0.0:
                nx, ny, nz = -nx, -ny, -nz
        normal[r, 0], normal[r, 1], normal[r, 2] = nx, ny, nz
    return Landed(kind, place, normal, local, far)
