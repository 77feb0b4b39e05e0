"""Under which geometry a figure was measured: stated beside each line of a table."""

from __future__ import annotations

import math
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from pipeline_tracker.evaluation.schema import Setup
from pipeline_tracker.simulation.scenario import Scenario


class Geometry(BaseModel):
    """Cameras, mounting, lamps and pipe; null and empty where a bag does not tell."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int | None = Field(default=None, description="Image width, px")
    height: int | None = Field(default=None, description="Image height, px")
    field_of_view: float | None = Field(default=None, description="Horizontal field of view, deg")
    baseline: float | None = Field(
        default=None, description="Between the cameras, m; null for one camera"
    )
    translation: tuple[float, float, float] | None = Field(
        default=None, description="Left optical frame in base_link, m"
    )
    rotation: tuple[float, float, float] | None = Field(
        default=None, description="Its roll, pitch and yaw in base_link, deg"
    )
    lamps: tuple[tuple[float, float, float], ...] | None = Field(
        default=None, description="Places of the lamps in base_link, m"
    )
    distance: float | None = Field(
        default=None, description="Nominal height of the left camera above the pipe's top, m"
    )
    diameter: float | None = Field(default=None, description="Outer diameter of the true pipe, m")


def of_scenario(scenario: Scenario) -> Geometry:
    """Return the geometry of a scenario."""
    rig, mounting = scenario.camera.rig(), scenario.camera.mounting()
    left = rig.left
    return Geometry(
        width=left.width,
        height=left.height,
        field_of_view=_rounded(math.degrees(2.0 * math.atan(left.width / (2.0 * left.fx)))),
        baseline=None if rig.right is None else _rounded(rig.right.offset),
        translation=_three(mounting.translation),
        rotation=_three([math.degrees(angle) for angle in mounting.rpy()]),
        lamps=tuple(_three(lamp.position) for lamp in scenario.lamps),
        distance=scenario.path.distance,
        diameter=scenario.pipe.diameter,
    )


def of_setup(setup: Setup) -> Geometry:
    """Return the geometry that an evaluation found in the bag with the truth."""
    scenario = setup.scenario or {}
    width, height = setup.image_size or (None, None)
    angles = setup.mounting_rpy
    lamps = scenario.get("lamps")
    view, place = setup.field_of_view, setup.mounting_translation
    return Geometry(
        width=width,
        height=height,
        field_of_view=None if view is None else _rounded(math.degrees(view)),
        baseline=_rounded(setup.baseline) if setup.baseline else None,
        translation=None if place is None else _three(place),
        rotation=None if angles is None else _three([math.degrees(angle) for angle in angles]),
        lamps=None if lamps is None else tuple(_three(lamp["position"]) for lamp in lamps),
        distance=scenario.get("path", {}).get("distance"),
        diameter=setup.true_pipe_diameter,
    )


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (_rounded(value) for value in values)
    return x, y, z


def _rounded(value: float) -> float:
    # Angles in radians, given with few digits, are not to be shown with many.
    return round(float(value), 4)
