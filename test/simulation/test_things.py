"""What lies, grows and swims beside the pipe: seen, hiding, and throwing shadows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.simulation import simulate
from pipeline_tracker.simulation.fish import fish_body
from pipeline_tracker.simulation.pieces import Piece, merged, tube
from pipeline_tracker.simulation.raycaster import RayCaster
from pipeline_tracker.simulation.renderer import Rendering
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.scene import Scene
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.truth import HIDDEN, OUTSIDE, VISIBLE, Contours, frame_contours

Array = NDArray[np.float64]

EVEN = ("bed.stones=0", "path.lateral_start=0", "path.heading_sway_deg=0", "bed.drifts=[]")
# A pipe on the surface of a level bed, seen as a whole.
LEVEL = (*EVEN, "bed.burial=0.02", "bed.burial_variation=0", "bed.relief=0", "bed.roughness=0")
LEVEL = (*LEVEL, "bed.ripple_height=0", "pipe.sag_radius=1e6", "pipe.bend_radius=1e6")


def seen(sea: Sea, frame: int = 0) -> tuple[Rendering, Scene]:
    scene = sea.scene.at(float(sea.times()[frame]))
    return sea.picture(frame, 0), scene


def truth(sea: Sea, scene: Scene, frame: int = 0) -> Contours:
    base = sea.motion.pose(float(sea.times()[frame]))
    camera, pose = sea.scenario.camera.rig().left, base @ sea.mountings()[0]
    return frame_contours(scene.axis, scene.caster, camera, pose, np.arange(0.0, 4.0, 0.05))


def project(sea: Sea, places: Array, frame: int = 0) -> Array:
    """Return pixels (N, 2) of the left camera."""
    base = sea.motion.pose(float(sea.times()[frame]))
    return sea.scenario.camera.rig().left.project(
        (base @ sea.mountings()[0]).inverse().apply(places)
    )


@pytest.fixture(scope="module")
def plain(small: Callable[..., Scenario]) -> Rendering:
    return seen(build_sea(small(*LEVEL)))[0]


def test_things_change_nothing_else(small: Callable[..., Scenario], plain: Rendering) -> None:
    # Far behind the vehicle: not in view.
    away = "tubes=[{at: -3, offset: 0, angle_deg: 90, length: 2}]"
    other = seen(build_sea(small(*LEVEL, away, "weed.on_bed=0.0", "water.snow=0")))[0]
    assert np.array_equal(other.light, plain.light)


def test_a_cable_over_the_pipe_hides_its_contours_there(
    small: Callable[..., Scenario], plain: Rendering
) -> None:
    cable = "tubes=[{at: 1.5, offset: 0, angle_deg: 90, length: 5, diameter: 0.06}]"
    sea = build_sea(small(*LEVEL, cable))
    rendering, scene = seen(sea)
    found = truth(sea, scene)
    both = (found.flags != OUTSIDE).all(axis=0)
    # Seen from behind and above, a cable over the pipe hides what is a little farther on.
    at_cable = np.abs(found.chainage - 1.65) < 0.2
    assert (found.flags[:, at_cable & both] == HIDDEN).any(axis=1).all()
    assert (found.flags[:, ~at_cable & both] == VISIBLE).all()
    # It passes over the pipe: 6 cm nearer to a camera 2 m above.
    x, y = (
        project(sea, scene.axis.points(np.array([1.5])) + np.array([0.0, 0.0, 0.36]))[0]
        .round()
        .astype(int)
    )
    assert plain.distance[y, x] - rendering.distance[y, x] > 0.04
    assert rendering.coverage[y, x] < 1.0
    assert plain.coverage[y, x] == 1.0


def test_a_pipe_below_leaves_the_pipe_in_view(small: Callable[..., Scenario]) -> None:
    below = (
        "tubes=[{at: 1.5, offset: 0, angle_deg: 90, length: 5, diameter: 0.15, burial: 0.5,"
        "over: false}]"
    )
    sea = build_sea(small(*LEVEL, below))
    rendering, scene = seen(sea)
    found = truth(sea, scene)
    assert (found.flags[found.flags != OUTSIDE] == VISIBLE).all()
    x, y = (
        project(sea, scene.axis.points(np.array([1.5])) + np.array([0.0, 0.0, 0.3]))[0]
        .round()
        .astype(int)
    )
    assert rendering.coverage[y, x] == 1.0


def test_a_tube_has_its_place_and_its_width(small: Callable[..., Scenario]) -> None:
    beside = (
        "tubes=[{at: 1.5, offset: 0.8, angle_deg: 0, length: 8, diameter: 0.2, burial: 0,"
        "colour: [0, 0, 0], sediment: 0}]"
    )
    clear = ("water.backscatter=[0,0,0]", "camera.width=384", "camera.height=256")
    sea = build_sea(small(*LEVEL, *clear, beside))
    rendering, scene = seen(sea)
    black = rendering.light[..., 1] < 0.2 * np.median(rendering.light[..., 1])
    # The row in which its axis at chainage 1.5 lies, 0.1 m above the bed.
    bed = float(scene.bed.height_at(np.array([[1.5, 0.8]]))[0])
    middle = np.array([[1.5, 0.8, bed + 0.1]])
    x, y = project(sea, middle)[0]
    row = np.flatnonzero(black[round(y)])
    run = row[np.abs(row - x) < 40]
    assert np.mean(run) == pytest.approx(x, abs=2.0)
    depth = (sea.motion.pose(0.0) @ sea.mountings()[0]).inverse().apply(middle)[0, 2]
    focal = sea.scenario.camera.rig().left.fx
    assert len(run) == pytest.approx(0.2 * focal / depth, abs=2.5)


def test_a_cable_throws_a_shadow(small: Callable[..., Scenario]) -> None:
    # A lamp far out at port lights a cable that hangs above the bed.
    lamp = "lamps=[{position: [1.2, 2.0, -0.8], direction: [0, -1, -0.7], radius: 0}]"
    cable = "tubes=[{at: 1.5, offset: 1.0, length: 6, diameter: 0.08, burial: -1.5}]"
    dark = (*LEVEL, lamp, "water.ambient=0.0", "bed.texture=0", "camera.width=384")
    with_it, without = (seen(build_sea(small(*dark, *more)))[0] for more in ((cable,), ()))
    same_place = np.abs(with_it.distance - without.distance) < 1e-3
    lit = without.light[..., 1] > np.median(without.light[..., 1])
    shadow = same_place & lit & (with_it.light[..., 1] < 0.4 * without.light[..., 1])
    assert shadow.sum() > 40


def test_the_edge_of_a_ledge_is_straight_and_steep(small: Callable[..., Scenario]) -> None:
    # On an uneven bed.
    ledge = "ledges=[{at: 1.6, offset: 0.7, angle_deg: 20, length: 2.0, width: 0.6, height: 0.3}]"
    sea = build_sea(small("bed.stones=0", ledge, "bed.relief=0.2"))
    scene = sea.scene
    tangent, right, _ = (v[0] for v in scene.axis.frames(np.array([1.6])))
    along = np.array([tangent[0], tangent[1], 0.0]) / np.hypot(*tangent[:2])
    port = np.array([-along[1], along[0], 0.0])
    turn = np.deg2rad(20.0)
    along, port = (
        np.cos(turn) * along + np.sin(turn) * port,
        np.cos(turn) * port - np.sin(turn) * along,
    )
    middle = scene.axis.points(1.6) - 0.7 * right
    # Rays straight down, one row just before the edge, one just behind it.
    t = np.linspace(-0.8, 0.8, 17)[:, None]
    heights = []
    for off in (-0.01, 0.01):
        origins = (middle + t * along + off * port + [0.0, 0.0, 3.0]).astype(np.float32)
        down = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(origins), 1))
        heights.append(origins[:, 2] - scene.caster.nearest(origins, down).distance)
    assert (heights[1] - heights[0] > 0.15).all()
    straight = np.polyval(np.polyfit(t[:, 0], heights[1], 1), t[:, 0])
    assert np.abs(heights[1] - straight).max() < 0.01


def test_weed_hides_contours_and_breaks_the_outline(
    small: Callable[..., Scenario], plain: Rendering
) -> None:
    wild = build_sea(small(*LEVEL, "weed.pipe_share=0.5", "weed.height=0.15"))
    rendering, scene = seen(wild)
    found = truth(wild, scene)
    inside = found.flags != OUTSIDE
    hidden = (found.flags == HIDDEN).sum() / inside.sum()
    assert 0.15 < hidden < 0.95
    # The true contour is that of the bare pipe, hidden or not.
    bare = build_sea(small(*LEVEL))
    same = truth(bare, bare.scene)
    assert np.array_equal(same.pixels, found.pixels, equal_nan=True)
    assert (same.flags[inside] == VISIBLE).all()
    covered = (plain.coverage == 1.0) & (rendering.coverage < 0.5)
    assert 0.1 < covered.sum() / (plain.coverage == 1.0).sum() < 0.9
    # It stands out beyond the pipe.
    beyond = (plain.coverage == 0.0) & (rendering.distance < plain.distance - 0.1)
    assert beyond.sum() > 100


def test_the_share_of_weed_is_about_what_is_asked(small: Callable[..., Scenario]) -> None:
    shares = []
    for share in (0.1, 0.4, 0.6):
        sea = build_sea(small(*LEVEL, f"weed.pipe_share={share}", "weed.height=0.1"))
        axis, s = sea.scene.axis, np.linspace(-3.0, 6.0, 4000)
        origins = (axis.points(s) + np.array([0.0, 0.0, 3.0])).astype(np.float32)
        down = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(s), 1))
        shares.append((sea.scene.caster.nearest(origins, down).mesh != 0).mean())
    assert shares[0] < shares[1] < shares[2]
    assert shares[1] == pytest.approx(0.4, abs=0.2)


def test_weed_on_the_bed_stays_off_nothing_but_grows(small: Callable[..., Scenario]) -> None:
    sea = build_sea(small(*LEVEL, "weed.on_bed=2"))
    again = build_sea(small(*LEVEL, "weed.on_bed=2", "frames=3"))
    other = build_sea(small(*LEVEL, "weed.on_bed=2", seed=3))
    # More frames: more weed, and what there was before as it was.
    few, many = ({tuple(n) for n in s.scene.solids.things.normals.tolist()} for s in (sea, again))
    assert few <= many
    assert not few & {tuple(n) for n in other.scene.solids.things.normals.tolist()}


@pytest.fixture(scope="module")
def school(small: Callable[..., Scenario]) -> Sea:
    return build_sea(small(*LEVEL, "fish.count=12", "fish.length=0.4", "fish.spread=0.8"))


def test_fish_are_seen_move_and_keep_away(school: Sea, plain: Rendering) -> None:
    pictures = [seen(school, frame)[0] for frame in (0, 1)]
    fish = [p.distance < plain.distance - 0.1 for p in pictures[:1]]
    assert fish[0].sum() > 100
    assert not np.array_equal(pictures[0].light, pictures[1].light)
    assert school.scene.school is not None
    left = school.mountings()[0]
    for time in np.linspace(0.0, 60.0, 61):
        eye = (school.motion.pose(float(time)) @ left).translation
        for piece in school.scene.school.pieces(float(time)):
            assert np.linalg.norm(piece.vertices - eye, axis=1).min() > 0.2
            s, _ = school.scene.axis.nearest(piece.vertices)
            gap = np.linalg.norm(piece.vertices - school.scene.axis.points(s), axis=1)
            assert gap.min() > 0.3


def test_fish_hide_contours_for_the_truth_too(school: Sea) -> None:
    hidden = 0
    for frame in (0, 1):
        _, scene = seen(school, frame)
        found = truth(school, scene, frame)
        still = truth(school, school.scene, frame)
        assert (still.flags[still.flags != OUTSIDE] == VISIBLE).all()
        hidden += int((found.flags == HIDDEN).sum())
        # A hidden point lies behind a fish: nearer than the pipe in the picture.
        rendering = school.picture(frame, 0)
        rows, columns = np.nonzero(found.flags == HIDDEN)
        for side, n in zip(rows, columns, strict=True):
            x, y = found.pixels[side, n].round().astype(int)
            x, y = min(max(x, 1), 190), min(max(y, 1), 126)
            near = rendering.distance[y - 1 : y + 2, x - 1 : x + 2].min()
            assert near < np.linalg.norm(found.points[side, n]) - 0.03
    assert hidden > 3


def test_fish_throw_shadows(small: Callable[..., Scenario]) -> None:
    dark = (*LEVEL, "bed.texture=0", "pipe.texture=0", "water.ambient=0")
    lamp = "lamps=[{position: [0.4, 1.2, -0.1], direction: [0.4, -0.5, -1], radius: 0}]"
    fish, none = (build_sea(small(*dark, lamp, f"fish.count={n}")).picture(0, 0) for n in (15, 0))
    same_place = np.abs(fish.distance - none.distance) < 1e-3
    shadow = same_place & (fish.light[..., 1] < 0.5 * none.light[..., 1])
    assert (shadow & (none.light[..., 1] > np.median(none.light[..., 1]))).sum() > 20


def test_the_same_fish_at_the_same_time(small: Callable[..., Scenario], school: Sea) -> None:
    again = build_sea(
        small(*LEVEL, "fish.count=14", "fish.length=0.4", "fish.spread=0.8", "frames=4")
    )
    other = build_sea(small(*LEVEL, "fish.count=12", seed=8))
    schools = [s.scene.school for s in (school, again, other)]
    one, two, three = (s.pieces(3.0)[5].vertices for s in schools if s is not None)
    # Neither more frames nor more fish change one.
    np.testing.assert_allclose(one, two, atol=1e-6)
    assert np.abs(one - three).max() > 0.1


def test_both_cameras_see_the_fish_at_the_same_place(school: Sea) -> None:
    left, right = (school.picture(0, n) for n in (0, 1))
    still = [school.renderer.render(school.motion.pose(0.0), n) for n in (0, 1)]
    counts = [
        ((p.distance < s.distance - 0.1) & np.isfinite(s.distance)).sum()
        for p, s in zip((left, right), still, strict=True)
    ]
    assert min(counts) > 0.4 * max(counts) > 0


def test_a_tubes_surface_is_closed_and_faces_outward() -> None:
    line = np.stack([np.linspace(0, 1, 12), 0.1 * np.linspace(0, 1, 12) ** 2, np.zeros(12)], 1)
    for piece in (tube(line, 0.05, 16, 0), fish_body(0.4, 0.3, 0)):
        assert closed(piece)
        np.testing.assert_allclose(np.linalg.norm(piece.normals, axis=1), 1.0, atol=1e-9)


def closed(piece: Piece) -> bool:
    """Return whether rays from far away that enter a piece also leave it."""
    mesh, data = merged([piece])
    caster = RayCaster({0: mesh})
    middle = piece.vertices.mean(axis=0)
    rng = np.random.default_rng(0)
    ways = rng.standard_normal((200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hits = caster.nearest(np.tile(middle.astype(np.float32), (200, 1)), ways.astype(np.float32))
    outward = np.sum(data.normals[data.faces[hits.face, 0]] * ways, axis=1)
    return bool((hits.mesh == 0).all() and (outward > -0.5).all())


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("tubes=[{diameter: 0}]", "tubes.0.diameter=0"),
        ("tubes=[{width: 1}]", "tubes.0.width"),
        ("ledges=[{height: -0.1}]", "ledges.0.height=-0.1"),
        ("weed.pipe_share=1.0", "weed.pipe_share=1.0"),
        ("fish.count=-1", "fish.count=-1"),
        ("fish.highest=0.95", "fish.highest=0.95"),
        ("water.snow=-1", "water.snow=-1"),
        ("pipe.present=3", "pipe.present=3"),
    ],
)
def test_impossible_things_are_refused(override: str, words: str) -> None:
    with pytest.raises(SettingsError) as refused:
        load_scenario("demo", [override])
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_sea_full_of_things_is_the_same_again(tmp_path: Path) -> None:
    full = (
        *("camera.width=96", "camera.height=64", "bed.resolution=0.08", "frames=2", "stretch=3"),
        *("water.snow=100", "fish.count=4", "weed.pipe_share=0.2", "weed.on_bed=1"),
    )
    one, two, other = (
        simulate("decoy", tmp_path / f"{n}" / "sea", full, seed, progress=False)
        for n, seed in enumerate((5, 5, 6))
    )
    bags = [{f.name: f.read_bytes() for f in bag.iterdir()} for bag in (one, two, other)]
    assert bags[0] == bags[1]
    assert bags[0] != bags[2]


def test_more_frames_leave_the_first_ones_as_they_were(small: Callable[..., Scenario]) -> None:
    things = ("weed.pipe_share=0.2", "fish.count=4", "water.snow=100", "stretch=4")
    lying = "tubes=[{at: 1.0, offset: 0.5, angle_deg: 30, wave: 0.1}]"
    few, many = (build_sea(small(*things, lying, f"frames={n}")) for n in (2, 4))
    assert np.array_equal(few.picture(1, 0).light, many.picture(1, 0).light)


@pytest.mark.parametrize(
    "thing",
    [
        "tubes=[{at: 0, offset: 0.3, length: 9, diameter: 3, burial: 0}]",
        "ledges=[{at: 0.5, offset: -2, length: 9, width: 20, height: 3}]",
    ],
)
def test_a_vehicle_inside_a_thing_is_refused(small: Callable[..., Scenario], thing: str) -> None:
    with pytest.raises(SettingsError, match="inside or below something on the bed"):
        build_sea(small(*LEVEL, thing))
