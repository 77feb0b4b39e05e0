"""The models of what lies, grows and swims in a scenario's sea beside the pipe."""

from __future__ import annotations

from pipeline_tracker.settings import Section
from pipeline_tracker.simulation.scenario_values import Colour, value


class TubeModel(Section):
    """A cable or a further pipe on the bed, draped over what it crosses."""

    at: float = value(0.0, "Chainage of its middle", unit="m")
    offset: float = value(0.8, "Its middle to port of the axis", unit="m", ge=-20, le=20)
    angle_deg: float = value(
        0.0, "Its way to the pipe's, positive to port; 0: beside it", unit="deg", ge=-180, le=180
    )
    length: float = value(20.0, "Length", unit="m", gt=0.1, le=1000)
    diameter: float = value(0.04, "Diameter", unit="m", ge=0.004, le=3)
    burial: float = value(0.1, "Share of its diameter below the bed", ge=-2, le=2)
    over: bool = value(True, "It lies over the pipe where it crosses; else on the bed, below it")
    wave: float = value(0.0, "How far its way winds to the sides", unit="m", ge=0, le=5)
    wave_length: float = value(2.5, "Length of a winding", unit="m", gt=0.1, le=100)
    colour: Colour = value((0.06, 0.06, 0.06), "Share of light returned: red, green, blue")
    texture: float = value(0.5, "Contrast of the surface", ge=0, le=2)
    sediment: float = value(0.3, "Share of the upper side dusted with sediment", ge=0, le=1)


class LedgeModel(Section):
    """A slab of rock with one straight, sharp edge; behind it the rock sinks into the bed."""

    at: float = value(0.0, "Chainage of its edge's middle", unit="m")
    offset: float = value(1.0, "Its edge's middle to port of the axis", unit="m", ge=-20, le=20)
    angle_deg: float = value(
        0.0,
        "Its edge to the pipe, positive to port; the rock lies to port of the edge, so 180 turns "
        "it to starboard",
        unit="deg",
        ge=-180,
        le=180,
    )
    length: float = value(6.0, "Length of the edge", unit="m", gt=0.1, le=100)
    width: float = value(0.8, "From the edge to where the rock meets the bed", unit="m", gt=0.05)
    height: float = value(0.15, "Height of the edge above the bed", unit="m", gt=0, le=3)
    colour: Colour = value((0.26, 0.25, 0.22), "Share of light returned: red, green, blue")
    texture: float = value(0.9, "Contrast of the surface", ge=0, le=2)
    sediment: float = value(0.5, "Share of the upper side dusted with sediment", ge=0, le=1)


class WeedModel(Section):
    """Soft growth that stands out from what it grows on, and hides it."""

    pipe_share: float = value(0.0, "Share of the pipe's upper side under clumps", ge=0, le=0.95)
    on_bed: float = value(0.0, "Clumps on a square metre of bed", unit="1/m²", ge=0, le=50)
    height: float = value(0.14, "Median height of a clump", unit="m", gt=0.01, le=2)
    lumps: float = value(0.25, "Share of lumps among the clumps, the others are tufts", ge=0, le=1)
    colour: Colour = value((0.10, 0.13, 0.05), "Share of light returned: red, green, blue")


class FishModel(Section):
    """Fish that swim between the cameras and the pipe, along with the vehicle."""

    count: int = value(0, "How many", ge=0, le=200)
    length: float = value(0.35, "Median length", unit="m", gt=0.02, le=3)
    ahead: float = value(1.2, "Their middle ahead of base_link", unit="m", ge=-20, le=20)
    spread: float = value(1.2, "How far they roam ahead and aside", unit="m", gt=0, le=20)
    highest: float = value(
        0.6, "Highest above the pipe's top, share of path.distance", gt=0.05, le=0.85
    )
    period: float = value(16.0, "Typical time of a turn to and fro", unit="s", gt=0.5, le=600)
    colour: Colour = value((0.17, 0.19, 0.20), "Share of light returned: red, green, blue")
