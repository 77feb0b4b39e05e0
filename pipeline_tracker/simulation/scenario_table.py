"""The table of scenarios in docs/scenarios.md.

``python -m pipeline_tracker.simulation.scenario_table > docs/scenarios.md``
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

import numpy as np

from pipeline_tracker.simulation.scenario import LampModel, Scenario
from pipeline_tracker.simulation.scenario_files import list_scenarios, load_scenario

_HEAD = """\
# Scenarios

`pipeline-tracker simulate NAME --output BAG` renders them, `--set KEY=VALUE` changes any of their
values. This table is written by `python -m pipeline_tracker.simulation.scenario_table`.
"""

_GEOMETRY = """\
## Camera, mounting, lamps, way

All lengths in metres. Mounting: the left camera's place in base_link, and how far it looks forward
of straight down and to port. Height: of the left camera above the pipe's top. Lamps: place in
base_link, and the angle off the beam's axis where half its strength is left. Water: attenuation
and backscatter of green light on each metre, and particles of marine snow in a cubic metre.
"""


def scenario_table() -> str:
    """Return the text of docs/scenarios.md."""
    names = list(list_scenarios())
    scenarios = {name: load_scenario(name) for name in names}
    what = [(f"`{name}`", s.description) for name, s in scenarios.items()]
    geometry = [(f"`{name}`", *_geometry(s)) for name, s in scenarios.items()]
    head = (
        "scenario",
        "pairs, way between",
        "image, px",
        "view",
        "baseline",
        "mounting",
        "height",
        "pipe",
        "lamps",
        "water",
    )
    parts = [_HEAD, *_rows(("scenario", "what"), what), "", _GEOMETRY, *_rows(head, geometry)]
    return "\n".join(parts) + "\n"


def _rows(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    for row in (head, ("---",) * len(head), *rows):
        yield f"| {' | '.join(row)} |"


def _geometry(s: Scenario) -> tuple[str, ...]:
    camera, path, water = s.camera, s.path, s.water
    kind = "mono" if camera.mono else f"{camera.baseline:g}"
    return (
        f"{s.frames} x {path.speed * path.period:g}",
        f"{camera.width} x {camera.height}",
        f"{camera.field_of_view_deg:g}°",
        kind,
        f"{_place(camera.translation)}, {_tilt(s)}",
        f"{path.distance:g}",
        f"{s.pipe.diameter:g}" if s.pipe.present else "none",
        "; ".join(_lamp(lamp) for lamp in s.lamps),
        f"{water.attenuation[1]:g}, {water.backscatter[1]:g}, {water.snow:g}",
    )


def _place(place: tuple[float, float, float]) -> str:
    return f"({', '.join(f'{value:g}' for value in place)})"


def _tilt(s: Scenario) -> str:
    """Return the tilt of the left camera's sight, forward and to port, in degrees."""
    sight = s.camera.mounting().rotation[:, 2]
    forward, port = (np.rad2deg(np.arctan2(sight[k], -sight[2])) for k in (0, 1))
    # Written so that -0 is 0.
    return f"{forward + 0.0:.0f}° forward" + (f", {port:.0f}° to port" if abs(port) > 0.5 else "")


def _lamp(lamp: LampModel) -> str:
    strength = f" x {lamp.power:g}" if lamp.power != 1.0 else ""
    return f"{_place(lamp.position)} {lamp.half_angle_deg:g}°{strength}"


if __name__ == "__main__":
    sys.stdout.write(scenario_table())
