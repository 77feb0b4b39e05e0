"""From hits to light: where a ray landed, and what it sees there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.fast import fast
from pipeline_tracker.simulation.light import Haze, Lamps, Water, arriving, haze_at
from pipeline_tracker.simulation.materials import (
    BedMaterial,
    PipeMaterial,
    Surface,
    bed_surface,
    pipe_surface,
    stone_surface,
    thing_surface,
)
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


class Materials(NamedTuple):
    """What they look like; stones are of the bed's material, things have one row each."""

    pipe: PipeMaterial
    bed: BedMaterial
    things: Array


class Lighting(NamedTuple):
    """Lamps in the world, the water, and the haze before one camera."""

    lamps: Lamps
    water: Water
    haze: Haze


class Eye(NamedTuple):
    """Where rays start (world, m), and the width of a pixel, rad."""

    origin: Array
    pixel: float


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


@fast
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


@fast
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


@fast
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


@fast
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


@fast
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


@fast
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


@fast
def _surface(
    landed: Landed, r: int, footprint: float, materials: Materials, tube: Tube
) -> tuple[Surface, float, float, float]:
    """Return the surface at a hit and its normal, tilted by the small relief."""
    nx, ny, nz = landed.normal[r, 0], landed.normal[r, 1], landed.normal[r, 2]
    a, b = landed.local[r, 0], landed.local[r, 1]
    p = landed.place
    if landed.kind[r] == PIPE:
        surface = pipe_surface(a, b, nz, footprint, materials.pipe)
        i = min(max(int((a - tube.start) / tube.step), 0), tube.up.shape[0] - 1)
        tx = tube.up[i, 1] * tube.right[i, 2] - tube.up[i, 2] * tube.right[i, 1]
        ty = tube.up[i, 2] * tube.right[i, 0] - tube.up[i, 0] * tube.right[i, 2]
        tz = tube.up[i, 0] * tube.right[i, 1] - tube.up[i, 1] * tube.right[i, 0]
        # The way around grows along tangent x normal.
        ax, ay, az = ty * nz - tz * ny, tz * nx - tx * nz, tx * ny - ty * nx
        nx -= surface.slope_a * tx + surface.slope_b * ax
        ny -= surface.slope_a * ty + surface.slope_b * ay
        nz -= surface.slope_a * tz + surface.slope_b * az
    elif landed.kind[r] == BED:
        surface = bed_surface(a, b, footprint, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    elif landed.kind[r] >= FIRST_THING:
        row = materials.things[landed.kind[r] - FIRST_THING]
        surface = thing_surface(a, b, nz, footprint, row, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    else:
        surface = stone_surface(p[r, 0], p[r, 1], p[r, 2], a, footprint, materials.bed)
        nx -= surface.slope_a
        ny -= surface.slope_b
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    return surface, nx / norm, ny / norm, nz / norm


@fast
def shade(
    landed: Landed,
    lit: Float32Array,
    pixels: Float32Array,
    eye: Eye,
    lighting: Lighting,
    tube: Tube,
    materials: Materials,
) -> Float32Array:
    """Return the light that arrives along N rays.

    Args:
        landed: where they landed.
        lit: (N, L) float32, share of lamp l that is not hidden from the place.
        pixels: (N, 2), column and row in the image as shares 0 to 1, for the haze.
        eye: the camera.
        lighting: lamps, water and haze.
        tube: the pipe's frames.
        materials: of pipe and bed.

    Returns:
        (N, 3) float32, red, green, blue.
    """
    lamps, water, haze = lighting
    origin = eye.origin
    n = landed.kind.size
    result = np.zeros((n, 3), np.float32)
    light = np.zeros(3)
    for r in range(n):
        distance = landed.distance[r]
        if landed.kind[r] != NOTHING:
            x, y, z = landed.place[r, 0], landed.place[r, 1], landed.place[r, 2]
            facing = (
                (origin[0] - x) * landed.normal[r, 0]
                + (origin[1] - y) * landed.normal[r, 1]
                + (origin[2] - z) * landed.normal[r, 2]
            ) / distance
            footprint = eye.pixel * distance / np.sqrt(max(facing, 0.1))
            surface, nx, ny, nz = _surface(landed, r, footprint, materials, tube)
            for c in range(3):
                light[c] = (
                    water.ambient[c] * (0.6 + 0.4 * nz) * np.exp(-water.attenuation[c] * distance)
                )
            for k in range(lamps.position.shape[0]):
                if lit[r, k] <= 0.0:
                    continue
                strength, way = arriving(lamps, k, x, y, z)
                slant = (
                    (lamps.position[k, 0] - x) * nx
                    + (lamps.position[k, 1] - y) * ny
                    + (lamps.position[k, 2] - z) * nz
                ) / way
                if slant <= 0.0:
                    continue
                strength *= lit[r, k]
                for c in range(3):
                    light[c] += (
                        strength
                        * slant
                        * lamps.power[k, c]
                        * np.exp(-water.attenuation[c] * (way + distance))
                    )
            result[r, 0] = surface.red * light[0]
            result[r, 1] = surface.green * light[1]
            result[r, 2] = surface.blue * light[2]
        red, green, blue = haze_at(haze, pixels[r, 0], pixels[r, 1], distance)
        result[r, 0] += red
        result[r, 1] += green
        result[r, 2] += blue
    return result
