"""All that is in a scenario's sea beside pipe, bed and stones, and what it is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.bed import Bed, Bounds
from pipeline_tracker.simulation.bed_objects import ledge_on_bed, tube_on_bed
from pipeline_tracker.simulation.fish import School
from pipeline_tracker.simulation.landing import FIRST_OBJECT, FISH, TUFT, MeshData
from pipeline_tracker.simulation.materials import BLADE, SCALES, SOLID, thing_material
from pipeline_tracker.simulation.meshes import Mesh
from pipeline_tracker.simulation.pieces import Piece, merged
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.streams import random_stream
from pipeline_tracker.simulation.weed import weeds

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Things:
    """What there is.

    Attributes:
        mesh, data: of what stays in its place; may be empty.
        materials: (M, 7), the table for shading.
        school: the fish, or None.
    """

    mesh: Mesh
    data: MeshData
    materials: Array
    school: School | None


def things_of(scenario: Scenario, axis: PipeAxis, bed: Bed, bounds: Bounds) -> Things:
    """Make a scenario's things; they take no random numbers from anything else.

    Args:
        scenario: the scenario.
        axis: the pipe's axis.
        bed: the bed.
        bounds: what of the bed there is.
    """
    pieces: list[Piece] = list(weeds(scenario, axis, bed, bounds, TUFT))
    number = FIRST_OBJECT
    for n, tube in enumerate(scenario.tubes):
        rng = random_stream(scenario, "tube", n)
        present = scenario.pipe.present
        pieces.append(tube_on_bed(tube, axis, bed, rng, present=present, material=number))
        number += 1
    for n, ledge in enumerate(scenario.ledges):
        pieces += ledge_on_bed(ledge, axis, bed, random_stream(scenario, "ledge", n), number)
        number += 1
    mesh, data = merged(pieces)
    school = School.draw(scenario, axis, FISH) if scenario.fish.count else None
    return Things(mesh, data, _table(scenario), school)


def _table(scenario: Scenario) -> Array:
    weed = scenario.weed.colour
    rows = [
        thing_material(BLADE, weed),
        thing_material(SOLID, (1.5 * weed[0], 1.2 * weed[1], weed[2]), texture=0.8, grain=0.05),
        thing_material(SCALES, scenario.fish.colour),
    ]
    # The texture of a tube goes with its girth, that of rock does not.
    rows += [
        thing_material(SOLID, t.colour, t.texture, max(0.02, 0.7 * t.diameter), t.sediment)
        for t in scenario.tubes
    ]
    rows += [
        thing_material(SOLID, ledge.colour, ledge.texture, 0.25, ledge.sediment)
        for ledge in scenario.ledges
    ]
    return np.array(rows)
