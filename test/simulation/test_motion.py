from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.motion import Motion
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scene import draw_axis, view_reach


def drawn(scenario: Scenario, seed: int = 3) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion.draw(scenario, draw_axis(scenario, rng), rng)


def test_the_vehicle_keeps_its_distance_and_its_course(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20")
    motion = drawn(scenario)
    axis: PipeAxis = motion.axis
    left = scenario.camera.mounting()
    for t in np.arange(0.0, 20.0):
        base = motion.pose(float(t))
        camera = (base @ left).translation
        s, side = axis.nearest(camera)
        height = camera[2] - axis.points(s)[2] - axis.radius
        assert 1.6 < height < 2.4
        assert abs(side) < 0.9
        ahead = base.rotation[:, 0] @ axis.tangents(s)
        assert ahead > np.cos(np.deg2rad(15.0))
    # Beside the pipe at first, above it later.
    starts = axis.nearest(motion.pose(0.0).translation)[1]
    ends = axis.nearest(motion.pose(19.0).translation)[1]
    assert abs(starts - 0.45) < 0.11
    assert abs(ends) < 0.11


# No swaying and a straight pipe: what is left is the manoeuvre.
CALM = (
    "frames=30",
    "path.lateral_start=0",
    "path.lateral_sway=0",
    "path.distance_sway=0",
    "path.heading_sway_deg=0",
    "path.pitch_sway_deg=0",
    "path.roll_sway_deg=0",
    "pipe.bend_radius=1e6",
    "pipe.sag_radius=1e6",
)


@pytest.mark.parametrize(
    ("what", "size"),
    [
        ("lateral", 1.2),
        ("distance", -0.7),
        ("heading_deg", 25.0),
        ("pitch_deg", -8.0),
        ("roll_deg", 6.0),
    ],
)
def test_a_manoeuvre_is_held_and_left_again(
    small: Callable[..., Scenario], what: str, size: float
) -> None:
    here = f"{{at: 7, length: 2, settle: 3, {what}: {size}}}"
    motion, calm = drawn(small(*CALM, f"path.manoeuvres=[{here}]")), drawn(small(*CALM))
    names = ("lateral", "distance", "roll_deg", "pitch_deg", "heading_deg")

    def difference(time: float) -> dict[str, float]:
        one, two = motion.pose(time), calm.pose(time)
        move = one.translation - two.translation
        turn = np.rad2deg(one.rpy() - two.rpy())
        return dict(zip(names, [move[1], move[2], *turn], strict=True))

    # 0.5 m/s: it is held from chainage 6 to 8, 12 s to 16 s, and begins at 3 m.
    for time in (12.1, 14.0, 15.9):
        held = difference(time)
        assert held[what] == pytest.approx(size, abs=2e-3)
        assert all(abs(held[name]) < 2e-2 for name in names if name != what)
    for time in (0.0, 5.9, 22.2, 29.0):
        assert all(abs(value) < 1e-3 for value in difference(time).values())
    assert 0.2 < difference(9.0)[what] / size < 0.8


def test_the_scene_is_large_enough_for_the_manoeuvres(small: Callable[..., Scenario]) -> None:
    plain = small(*CALM)
    high = small(*CALM, "path.manoeuvres=[{at: 7, distance: 2, pitch_deg: -5}]")
    assert view_reach(high) > view_reach(plain) + 1.0
    assert high.path.highest == pytest.approx(4.0)
    aside = small(*CALM, "path.manoeuvres=[{at: 7, lateral: -2}, {at: 9, lateral: 1}]")
    assert aside.path.widest == pytest.approx(3.0)


def test_a_varying_speed_goes_neither_astern_nor_out_of_bounds(
    small: Callable[..., Scenario],
) -> None:
    scenario = small("frames=100", "path.speed_variation=0.8")
    times = np.arange(0.0, 99.0, 0.05)
    for seed in range(5):
        motion = drawn(scenario, seed)
        way = np.array([motion.chainage(time) for time in times])
        speed = np.diff(way) / 0.05
        assert speed.min() > 0.099
        assert speed.max() < 0.901
        assert speed.max() - speed.min() > 0.3
        assert np.abs(way - 0.5 * times).max() < scenario.path.surge
