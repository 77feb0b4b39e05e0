"""Techniques 1 to 3 on vectorized frames whose contours are known (4.2.4)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from silhouettes import Cylinder, outline_lines, outlines, pixels_of
from synthetic_world import DOWN, EXACT, LEFT, MONO, RIG, TILTED, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.recognition import closed_form
from pipeline_tracker.recognition.closed_form import (
    _direction_of_contour,
    _fit_line,
    contour_line,
    solve_by_technique,
)
from pipeline_tracker.surface import SurfacePoints, triangulate

Array = NDArray[np.float64]

GOOD = Look(spacing=40)


@pytest.fixture(autouse=True)
def _edges_on_contours(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """The edges of these pictures are on the contours, where real ones are a little outside."""
    if "outside" not in request.node.name:
        monkeypatch.setattr(closed_form, "EDGE_OUTSIDE", 0.0)


def known(diver: Diver, pose: Pose) -> Axis:
    """The true axis in the left optical frame, its origin abreast of the camera."""
    assert diver.world.pipe is not None
    to_optical = (pose @ diver.mounting).inverse()
    axis = Axis.straight(
        to_optical.apply(diver.world.pipe.point), to_optical.rotate(diver.world.pipe.direction)
    )
    flat = axis.direction[:2]
    return axis.moved(float(-axis.point[:2] @ flat / (flat @ flat)))


def solve(
    technique: int, diver: Diver, off: float = 0.0, seed: int = 0
) -> tuple[Axis, Array] | None:
    """Solve one frame, the contours being told by an axis that is off by some metres."""
    pose = level_pose()
    frame = diver.frame(pose, seed=seed)
    axis = known(diver, pose)
    rough = Axis.straight(axis.point + off * np.array([0.6, 0.6, 0.5]), axis.direction)
    vertical = diver.mounting.rotation.T @ np.array([0.0, 0.0, 1.0])
    return solve_by_technique(
        technique, frame, triangulate(frame.matches, frame.rig), rough, 0.3, vertical
    )


def errors(axis: Axis, true: Axis) -> tuple[float, float]:
    """Distance within 0.5 m of the middle, m, and turn, rad."""
    gaps = [
        np.linalg.norm(np.cross(axis.at(t) - true.point, true.direction)) for t in (-0.5, 0.0, 0.5)
    ]
    return float(max(gaps)), float(np.linalg.norm(np.cross(axis.direction, true.direction)))


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("heading", [0.0, 0.7, 1.57, 2.5])
def test_a_contour_is_fitted_to_the_segments_along_it(heading: float, number: int) -> None:
    diver = Diver(World.with_pipe(heading=heading), look=replace(GOOD, clutter=200))
    frame = diver.frame(level_pose(), seed=1)
    axis = known(diver, level_pose())
    camera = RIG.cameras[number]
    segments = (frame.left_segments, frame.right_segments)[number]
    true = outline_lines(Cylinder(axis.point, axis.direction, 0.3), camera)
    for side, line in zip((-1, 1), true, strict=True):
        found = contour_line(segments, camera, axis, 0.3, side)
        assert found is not None
        assert np.hypot(found[0], found[1]) == pytest.approx(1.0)
        along = np.array([-line[1], line[0]])
        foot = -line[2] * line[:2]
        middle = foot + along * ((np.array([599.5, 399.5]) - foot) @ along)
        ends = middle + np.array([[-300.0], [300.0]]) * along
        # 0.4 px at each end of about eight segments.
        assert np.abs(ends @ found[:2] + found[2]).max() < 1.0


def test_edges_outside_of_the_contour_are_moved_in() -> None:
    diver = Diver(World.with_pipe(heading=0.3), look=EXACT)
    axis = known(diver, level_pose())
    frame = diver.frame(level_pose())
    middle = LEFT.project(axis.point)
    for side in (-1, 1):
        line = contour_line(frame.left_segments, LEFT, axis, 0.3, side)
        true = outline_lines(Cylinder(axis.point, axis.direction, 0.3), LEFT)[int(side > 0)]
        assert line is not None
        # Nearer to the middle of the pipe by the offset, on either side.
        gaps = [abs(float(entry[:2] @ middle + entry[2])) for entry in (line, true)]
        assert gaps[1] - gaps[0] == pytest.approx(closed_form.EDGE_OUTSIDE, abs=0.05)


def test_too_little_of_a_contour_is_none() -> None:
    diver = Diver(World.with_pipe(), look=replace(GOOD, seen=(0.8, 0.0, 0.8, 0.8), clutter=0))
    frame = diver.frame(level_pose())
    axis = known(diver, level_pose())
    assert contour_line(frame.left_segments, LEFT, axis, 0.3, -1) is not None
    assert contour_line(frame.left_segments, LEFT, axis, 0.3, 1) is None


@pytest.mark.parametrize("mounting", [DOWN, TILTED], ids=["down", "tilted"])
@pytest.mark.parametrize("heading", [0.0, 0.5, 2.6, 3.1])
@pytest.mark.parametrize("technique", [1, 2, 3])
def test_exact_pictures_give_the_axis(technique: int, heading: float, mounting: Pose) -> None:
    diver = Diver(World.with_pipe(heading=heading), mounting=mounting, look=EXACT)
    solved = solve(technique, diver, off=0.003)
    assert solved is not None
    gap, turn = errors(solved[0], known(diver, level_pose()))
    # float32 segments, through planes that meet at 5 degrees for technique 3.
    bound = {1: 0.001, 2: 0.001, 3: 0.005}[technique]
    assert gap < bound
    assert turn < 2.0 * bound


@pytest.mark.parametrize("heading", [0.0, 0.5, 2.6])
@pytest.mark.parametrize("technique", [1, 2, 3])
def test_noisy_pictures_give_it_within_its_covariance(technique: int, heading: float) -> None:
    diver = Diver(World.with_pipe(heading=heading), look=GOOD)
    true = known(diver, level_pose())
    squares = []
    for seed in range(8):
        solved = solve(technique, diver, off=0.003, seed=seed)
        assert solved is not None
        axis, covariance = solved
        assert np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        left = np.cross([0.0, 0.0, -1.0], true.direction)
        left /= np.linalg.norm(left)
        up = np.cross(true.direction, left)
        there = true.moved(float((axis.point - true.point) @ true.direction))
        off, turn = axis.point - there.point, axis.direction - there.direction
        error = np.array([off @ left, off @ up, turn @ left, turn @ up])
        squares.append(float(error @ np.linalg.solve(covariance, error)))
    # Four degrees of freedom: a mean of 4 where it is exact. It may be careful, not bold.
    assert np.mean(squares) < 8.0


def test_technique_2_takes_the_right_image_where_the_left_shows_one_contour() -> None:
    look = replace(GOOD, seen=(0.8, 0.0, 0.8, 0.8), clutter=0)
    diver = Diver(World.with_pipe(heading=0.4), look=look)
    solved = solve(2, diver)
    assert solved is not None
    assert errors(solved[0], known(diver, level_pose()))[0] < 0.03
    assert solve(2, replace(diver, look=replace(look, seen=(0.8, 0.0, 0.0, 0.8)))) is None


def test_technique_3_needs_both_pairs_and_a_pipe_across_the_baseline() -> None:
    # Looking down with the picture's top forward, the baseline is across the vehicle.
    assert solve(3, Diver(World.with_pipe(heading=1.57), look=EXACT)) is None
    one = replace(EXACT, seen=(0.9, 0.9, 0.9, 0.0))
    assert solve(3, Diver(World.with_pipe(), look=one)) is None
    assert solve(3, Diver(World.with_pipe(), MONO, look=EXACT)) is None
    assert solve(3, Diver(World.with_pipe(), look=EXACT)) is not None


def test_the_direction_comes_from_matches_on_the_right_contour() -> None:
    random = np.random.default_rng(3)
    cylinder = Cylinder.seen(np.array([600.0, 400.0]), 2.0, 1.2, 0.1, 0.3, camera=LEFT)
    axis = Axis.straight(cylinder.point, cylinder.direction)
    _, right = outlines(cylinder, LEFT)
    on = right[0] + random.uniform(0.3, 0.7, (40, 1)) * (right[1] - right[0])
    # A third of the matches beside the edge are of the bed, a radius and more behind it.
    on[::3] *= 1.2
    pixels = pixels_of(on, LEFT)
    depths = on[:, 2] + random.normal(0.0, 0.004, 40)
    points = LEFT.rays(pixels) * depths[:, None]
    length = np.linalg.norm(points, axis=1)
    surface = SurfacePoints(points, points / length[:, None], np.full(40, 0.004), pixels, pixels)
    found = _direction_of_contour(surface, LEFT, axis, 0.3)
    assert found is not None
    # 4 mm in depth over more than a metre.
    assert abs(found @ cylinder.direction) > math.cos(0.01)
    assert _direction_of_contour(surface.subset(np.arange(40) < 5), LEFT, axis, 0.3) is None
    # Points close together have no direction.
    narrow = np.abs((points - points[1]) @ cylinder.direction) < 0.15
    assert _direction_of_contour(surface.subset(narrow), LEFT, axis, 0.3) is None


def test_technique_1_needs_a_face() -> None:
    assert solve(1, Diver(World.with_pipe(), look=replace(EXACT, texture=False))) is None
    assert solve(1, Diver(World.with_pipe(), MONO, look=EXACT)) is None


def test_the_axis_goes_the_way_of_the_known_one() -> None:
    diver = Diver(World.with_pipe(heading=0.3), look=EXACT)
    pose = level_pose()
    frame = diver.frame(pose)
    surface = triangulate(frame.matches, RIG)
    back = known(diver, pose).reversed()
    vertical = np.array([0.0, 0.0, -1.0])
    for technique in (1, 2, 3):
        solved = solve_by_technique(technique, frame, surface, back, 0.3, vertical)
        assert solved is not None
        assert solved[0].direction @ back.direction > 0.99
        # Its origin is in the middle of the view.
        assert abs(solved[0].point[:2] @ solved[0].direction[:2]) < 1e-6


def plain_line(pixels: Array, weights: Array, widths: tuple[float, ...]) -> Array:
    """Principal direction, again and again with less weight for what is off."""
    robust = np.ones(len(pixels))
    for width in widths:
        own = weights * robust
        centre = (pixels * own[:, None]).sum(axis=0) / own.sum()
        away = pixels - centre
        _, vectors = np.linalg.eigh((away * own[:, None]).T @ away)
        normal = vectors[:, 0]
        robust = np.square(1.0 / (1.0 + np.square(away @ normal / width)))
    return np.array([normal[0], normal[1], -float(normal @ centre)])


@pytest.mark.parametrize("turn", [0.0, 0.4, math.pi / 2, 2.5])
def test_the_line_of_a_contour_agrees_with_a_plain_fit(turn: float) -> None:
    random = np.random.default_rng(5)
    along, across = np.array([math.cos(turn), math.sin(turn)]), [-math.sin(turn), math.cos(turn)]
    off = np.where(random.random(80) < 0.3, 4.0, 0.0) + random.normal(0.0, 0.3, 80)
    pixels = 500.0 + random.uniform(-300.0, 300.0, (80, 1)) * along + off[:, None] * across
    weights = random.uniform(0.1, 1.0, 80)
    line = np.empty(3)
    _fit_line(pixels, weights, 2.0, line)
    expected = plain_line(pixels, weights, tuple(2.0 * w for w in closed_form._LINE_WIDTHS))
    assert abs(line[:2] @ expected[:2]) == pytest.approx(1.0, abs=1e-9)
    ends = np.stack((500.0 - 300.0 * along, 500.0 + 300.0 * along))
    assert np.abs(ends @ line[:2] + line[2]) == pytest.approx(
        np.abs(ends @ expected[:2] + expected[2]), abs=1e-6
    )


def test_what_it_is_off_the_known_axis_is_in_its_covariance() -> None:
    # All edges that can be seen are half a centimetre beside the contours, as at a shadow's border.
    diver = Diver(World.with_pipe(heading=0.4, radius=0.305), look=EXACT)
    frame, axis = diver.frame(level_pose()), known(diver, level_pose())
    vertical = np.array([0.0, 0.0, -1.0])
    surface = triangulate(frame.matches, RIG)
    solved = solve_by_technique(2, frame, surface, axis, 0.3, vertical)
    assert solved is not None
    off = solved[0].point - axis.moved(float((solved[0].point - axis.point) @ axis.direction)).point
    height = float(off @ vertical)
    assert abs(height) > 0.02
    assert solved[1][1, 1] > 0.9 * height**2
