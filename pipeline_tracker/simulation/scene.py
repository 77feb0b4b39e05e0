"""A scenario's scene: the pipe, the bed and what is on it, and what the renderer needs of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.bed import Bed, Bounds, Stones, scatter_stones
from pipeline_tracker.simulation.fish import School
from pipeline_tracker.simulation.landing import (
    BED,
    MOVERS,
    PIPE,
    STONE,
    THINGS,
    Ground,
    MeshData,
    Solids,
    Tube,
)
from pipeline_tracker.simulation.lens import lenses_of
from pipeline_tracker.simulation.materials import BedMaterial, PipeMaterial
from pipeline_tracker.simulation.meshes import TUBE_FACETS, tube_mesh
from pipeline_tracker.simulation.pieces import merged
from pipeline_tracker.simulation.raycaster import BothCasters, Caster, RayCaster
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.shading import Materials
from pipeline_tracker.simulation.things import things_of

Array = NDArray[np.float64]

# Rays nearer to the horizon than this see no bed within this reach, m.
_FARTHEST = 12.0


@dataclass(frozen=True)
class Scene:
    """Everything that can be seen.

    Attributes:
        axis: the pipe's axis, the truth.
        bed: the height field.
        caster: casts rays at it; its numbers are those of the meshes in landing.
        solids: the same for shading.
        materials: what they look like.
        school: what moves; it is in ``caster`` and ``solids`` in a scene ``at`` a time only.
    """

    axis: PipeAxis
    bed: Bed
    caster: Caster
    solids: Solids
    materials: Materials
    school: School | None

    def at(self, time: float) -> Scene:
        """Return the scene with what moves in its place at a time, s."""
        if self.school is None:
            return self
        mesh, data = merged(self.school.pieces(time))
        caster = BothCasters(self.caster, RayCaster({MOVERS: mesh}))
        return replace(self, caster=caster, solids=self.solids._replace(movers=data))


def view_reach(scenario: Scenario) -> float:
    """Return how far ahead of the vehicle or aside the cameras may see the bed, m."""
    camera, path = scenario.camera, scenario.path
    corners = np.array(
        [[x, y] for x in (0, camera.width / 2, camera.width) for y in (0, camera.height)], float
    )
    seen = np.concatenate([lens.rays(corners) for lens in lenses_of(camera)])
    rays = camera.mounting().rotate(seen)
    sway = np.deg2rad(path.steepest_deg)
    depression = np.arctan2(-rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])) - sway
    height = path.highest + scenario.pipe.diameter + scenario.bed.relief
    nearest = np.arctan2(height, _FARTHEST)
    reach = height / np.tan(np.maximum(depression, nearest))
    mount = float(np.hypot(camera.translation[0], camera.translation[1])) + camera.baseline
    return float(reach.max()) + mount + 0.5


def draw_axis(scenario: Scenario, rng: np.random.Generator) -> PipeAxis:
    """Draw the pipe's axis, longer at both ends than the cameras can see.

    Raises:
        SettingsError: a steady bend would lead it back to its beginning.
    """
    path = scenario.path
    margin = 1.15 * view_reach(scenario) + 2.0 + 2.0 * path.speed + path.surge
    radius, length = scenario.pipe.curve_radius, scenario.built_way + 2.0 * margin
    if radius and length > 1.5 * np.pi * abs(radius):
        raise SettingsError(
            f"pipe.curve_radius={radius:g}: {length:.0f} m of pipe would come round to where they "
            f"began, expected at least {length / (1.5 * np.pi):.1f} m; take a larger radius or "
            "fewer frames"
        )
    return PipeAxis.draw(scenario.pipe, -margin, scenario.built_way + margin, rng)


def build_scene(scenario: Scenario, axis: PipeAxis, rng: np.random.Generator) -> Scene:
    """Build the scene around a pipe.

    Args:
        scenario: the scenario.
        axis: from ``draw_axis``.
        rng: random numbers for bed, stones and textures.

    Raises:
        SettingsError: the bed's resolution is too fine for its size.
        PipelineTrackerError: the extra ``[sim]`` is not installed.
    """
    bounds = _bounds(scenario, axis)
    pipe = axis if scenario.pipe.present else None
    bed = Bed.draw(scenario.bed, axis, bounds, rng, level_beside=pipe is not None)
    stones = scatter_stones(scenario.bed, pipe, bed, bounds, rng)
    things = things_of(scenario, axis, bed, bounds)
    mesh, frames = tube_mesh(axis)
    meshes = {BED: bed.mesh()}
    if scenario.pipe.present:
        meshes[PIPE] = mesh
    if len(stones.mesh.faces):
        meshes[STONE] = stones.mesh
    if len(things.mesh.faces):
        meshes[THINGS] = things.mesh
    tube = Tube(
        frames.start,
        frames.step,
        TUBE_FACETS,
        axis.radius,
        frames.centre,
        frames.right,
        frames.up,
    )
    ground = Ground(bed.x0, bed.y0, bed.resolution, bed.slopes())
    _, nothing = merged([])
    solids = Solids(tube, ground, _stone_data(stones), things.data, nothing)
    materials = _materials(scenario, things.materials, rng)
    return Scene(axis, bed, RayCaster(meshes), solids, materials, things.school)


def _stone_data(stones: Stones) -> MeshData:
    count = len(stones.brightness)
    coordinates = np.stack([stones.brightness, np.zeros(count, np.float32)], axis=1)
    kinds = np.full(count, STONE, np.int8)
    return MeshData(stones.mesh.faces, stones.normals, coordinates, kinds, np.zeros(count, bool))


def _materials(scenario: Scenario, things: Array, rng: np.random.Generator) -> Materials:
    pipe, bed, seeds = scenario.pipe, scenario.bed, rng.integers(1 << 30, size=2)
    return Materials(
        PipeMaterial(
            pipe.colour,
            pipe.texture,
            pipe.growth,
            pipe.damage,
            pipe.sediment,
            bed.colour,
            pipe.joint_spacing,
            np.pi * pipe.diameter,
            int(seeds[0]),
        ),
        BedMaterial(bed.colour, bed.texture, int(seeds[1])),
        things,
    )


def _bounds(scenario: Scenario, axis: PipeAxis) -> Bounds:
    path, reach = scenario.path, view_reach(scenario)
    margin, more = reach + path.widest, path.speed + path.surge
    way = axis.points(np.linspace(-more, scenario.built_way + more, 200))
    low, high = way.min(axis=0) - margin, way.max(axis=0) + margin
    return Bounds(float(low[0]), float(high[0]), float(low[1]), float(high[1]))
