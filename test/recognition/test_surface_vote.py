"""Cylinders of known radius found by surface points alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_world import DOWN, RIG, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.recognition.surface_vote import (
    _best_level,
    _best_levels,
    _choose_distinct,
    _margin,
    _middle,
    _vote_again,
    dominant_plane,
    vote_for_cylinders,
)
from pipeline_tracker.surface import SurfacePoints, triangulate

Array = NDArray[np.float64]


def surface_of(world: World) -> SurfacePoints:
    frame = Diver(world, look=Look(spacing=40)).frame(level_pose())
    return triangulate(frame.matches, RIG)


@pytest.mark.parametrize("slope", [0.0, 0.12])
@pytest.mark.parametrize("heading", [0.0, 0.5, 1.0, 1.57, 2.2, 3.0])
def test_the_pipe_is_among_the_hypotheses(heading: float, slope: float) -> None:
    world = World.with_pipe(heading=heading, slope=slope, aside=0.2)
    found = vote_for_cylinders(surface_of(world), 0.3, RIG.left.width)
    scores = [score for _, score in found]
    assert scores == sorted(scores, reverse=True)
    # A start for a fit that catches 10 cm and 3 degrees or more, within 0.5 m of the middle. A flat
    # bed may have more votes: a buried cylinder is nearly flat, and the fit tells them apart.
    assert any(is_near(axis, world) for axis, _ in found[:5])


def is_near(axis: Axis, world: World) -> bool:
    assert world.pipe is not None
    ends = DOWN.apply(np.stack([axis.at(t) for t in (-0.5, 0.5)]))
    cosine = abs(float(DOWN.rotate(axis.direction) @ world.pipe.direction))
    return float(world.pipe.from_axis(ends).max()) < 0.12 and cosine > math.cos(math.radians(6.0))


def test_a_thinner_pipe_gets_fewer_votes_than_one_of_the_radius() -> None:
    right = vote_for_cylinders(surface_of(World.with_pipe()), 0.3, RIG.left.width)[0][1]
    thin = World.with_pipe(radius=0.1, height=2.2)
    votes = [score for _, score in vote_for_cylinders(surface_of(thin), 0.3, RIG.left.width)]
    assert max(votes, default=0.0) < 0.8 * right


def test_too_few_or_too_poor_points_give_no_hypothesis() -> None:
    surface = surface_of(World.with_pipe())
    few = surface.subset(np.arange(len(surface.points)) < 10)
    assert vote_for_cylinders(few, 0.3, RIG.left.width) == []
    poor = SurfacePoints(
        surface.points,
        surface.rays,
        np.full(len(surface.points), 0.2),
        surface.left_pixels,
        surface.right_pixels,
    )
    assert vote_for_cylinders(poor, 0.3, RIG.left.width) == []


def test_no_more_hypotheses_than_asked_for_and_none_twice() -> None:
    found = vote_for_cylinders(surface_of(World.with_pipe()), 0.3, RIG.left.width, most=3)
    assert len(found) <= 3
    for k, (axis, _) in enumerate(found):
        for other, _ in found[k + 1 :]:
            gap = np.linalg.norm(np.cross(axis.point - other.point, other.direction))
            assert abs(axis.direction @ other.direction) <= 0.97 or gap >= 0.3


def test_the_dominant_plane_is_the_bed_under_the_pipe() -> None:
    random = np.random.default_rng(2)
    normal = np.array([0.2, -0.1, -1.0])
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    place = random.uniform(-1.0, 1.0, (400, 2))
    bed = np.array([0.0, 0.0, 2.5]) + place[:, :1] * first + place[:, 1:] * second
    bed += 0.004 * random.normal(size=(400, 1)) * normal
    # Up to 60 cm of pipe stand on a quarter of it.
    rise = random.uniform(0.1, 0.6, (100, 1))
    points = np.concatenate((bed, bed[:100] + rise * normal))
    centre, found = dominant_plane(points, np.full(len(points), 0.005))
    assert found @ normal > math.cos(math.radians(1.5))
    assert abs((centre - bed.mean(axis=0)) @ normal) < 0.02


def plain_plane(points: Array, sigmas: Array) -> tuple[Array, Array]:
    """A plane through weighted points, those off it with less weight."""
    base = 1.0 / np.square(np.hypot(sigmas, 0.05))
    weights = base
    for _ in range(5):
        centre = (points * weights[:, None]).sum(axis=0) / weights.sum()
        away = points - centre
        _, vectors = np.linalg.eigh((away * weights[:, None]).T @ away)
        height = away @ vectors[:, 0]
        spread = max(float(np.median(np.abs(height))), 1e-3)
        weights = base / (1.0 + np.square(height / (2.0 * spread)))
    normal = vectors[:, 0]
    return centre, -normal if float(normal @ centre) > 0 else normal


def test_the_dominant_plane_agrees_with_a_plain_fit() -> None:
    surface = surface_of(World.with_pipe(heading=0.3, slope=0.1))
    centre, normal = dominant_plane(surface.points, surface.depth_sigmas)
    expected_centre, expected_normal = plain_plane(surface.points, surface.depth_sigmas)
    assert np.allclose(normal, expected_normal, atol=1e-6)
    assert np.allclose(centre, expected_centre, atol=1e-6)


def test_lines_that_are_kept_are_distinct_from_all_before() -> None:
    random = np.random.default_rng(8)
    places = random.normal(0.0, 0.4, (60, 3))
    directions = np.array([0.0, 1.0, 0.0]) + random.normal(0.0, 0.15, (60, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    kept = np.empty(12, np.int64)
    chosen = kept[: _choose_distinct(places, directions, 0.3, kept)].tolist()
    plain: list[int] = []
    for k in range(60):
        gaps = [np.linalg.norm(np.cross(places[k] - places[j], directions[j])) for j in plain]
        alike = [abs(directions[k] @ directions[j]) > 0.97 for j in plain]
        if not any(near and gap < 0.3 for near, gap in zip(alike, gaps, strict=True)):
            plain.append(k)
    assert len(plain) > 2
    assert chosen == plain[:12]


def plain_level(heights: Array, slack: Array, levels: Array) -> Array:
    """Votes less objections for each level, point by point."""
    scores = np.zeros(len(levels))
    width = levels[1] - levels[0]
    for k, level in enumerate(levels):
        off = heights - level
        on = np.abs(off) <= slack
        scores[k] += (1.0 - 0.5 * np.abs(off[on]) / slack[on]).sum()
        # What stands above the pipe, by whole cells; what lies inside it.
        scores[k] -= 0.4 * (np.ceil((heights - slack - levels[0]) / width) > k).sum()
        scores[k] -= 0.7 * (np.floor((heights + slack - levels[0]) / width) < k).sum()
    return scores


def test_the_best_level_agrees_with_a_slow_vote() -> None:
    random = np.random.default_rng(6)
    for _ in range(20):
        count = int(random.integers(8, 60))
        heights = np.where(random.random(count) < 0.6, 2.0, 2.3) + random.normal(0, 0.03, count)
        slack, table = random.uniform(0.03, 0.08, count), np.empty((3, 66))
        votes, level = _best_level(heights, slack / 0.018, count, 0.018, table, np.empty(32))
        # The table's cells, from the level that was found.
        levels = level + 0.018 * np.arange(-66, 67)
        scores = plain_level(heights, slack, levels)
        assert votes == pytest.approx(scores[66], abs=1e-6)
        inside = np.abs(levels - np.median(heights)) < 0.5
        assert votes >= scores[inside].max() - 1e-6


def test_the_best_levels_of_all_elevations_are_those_of_each() -> None:
    random = np.random.default_rng(7)
    for _ in range(20):
        count = int(random.integers(8, 60))
        heights = np.where(random.random((count, 1)) < 0.6, 2.0, 2.3)
        heights = heights + random.normal(0.0, 0.03, (count, 8)) + 0.2 * np.arange(8)
        reaches = random.uniform(1.0, 3.0, count)
        # The cells of each as for it alone.
        lows = np.array([_low(heights[:, e].copy(), count) for e in range(8)])
        votes, levels = np.empty(8), np.empty(8)
        margin = _margin(reaches)
        table = np.empty((3, 66 + 2 * margin, 8))
        _best_levels(heights, reaches, count, 0.018, lows, table, margin, votes, levels)
        for e in range(8):
            alone = heights[:, e].copy()
            room = np.empty((3, 66)), np.empty(32)
            expected = _best_level(alone, reaches, count, 0.018, *room)
            assert (votes[e], levels[e]) == pytest.approx(expected, abs=1e-9)


def _low(heights: Array, count: int) -> float:
    return float(_middle(heights, count, np.empty(32)) - 0.5 * 66 * 0.018)


def test_all_points_vote_again_for_what_some_found() -> None:
    world = World.with_pipe(heading=0.5)
    assert world.pipe is not None
    surface = surface_of(world)
    direction = DOWN.inverse().rotate(world.pipe.direction)
    side = np.cross(np.array([0.0, 0.0, -1.0]), direction)
    up = np.array([[0.0, 0.0, -1.0]])
    axis = DOWN.inverse().apply(world.pipe.point)
    found = np.array([[1.0, float(axis @ side) + 0.08, 0.0]])
    tolerance = np.full(len(surface.points), 0.05)
    _vote_again(surface.points, tolerance, side[None], up, 0.3, found)
    # A step of 7.5 cm to the side is where the axis is, and its height comes with it.
    assert found[0, 1] == pytest.approx(float(axis @ side), abs=0.01)
    assert found[0, 2] == pytest.approx(float(axis @ up[0]), abs=0.03)
    assert found[0, 0] > 20.0
