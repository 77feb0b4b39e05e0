"""Which contours: candidates, pairs of them, and shadows (4.2.1 to 4.2.3)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from silhouettes import Cylinder, outline_lines
from synthetic_world import DOWN, LEFT, RIG, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.recognition.contours import (
    contour_candidates,
    is_shadow,
    pair_hypotheses,
)
from pipeline_tracker.recognition.hough import HoughLine

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GREY = np.full((100, 150), 120, np.uint8)
HEADINGS = (0.0, 0.02, 0.8, 1.57, 2.3, 3.1)


def scene(heading: float, number: int = 0, seed: int = 0) -> tuple[NDArray[np.float32], Cylinder]:
    """Segments of one image with clutter, and the pipe in the left optical frame."""
    world = World.with_pipe(heading=heading, aside=0.1)
    frame = Diver(world, look=Look(clutter=200)).frame(level_pose(), seed=seed)
    assert world.pipe is not None
    to_optical = DOWN.inverse()
    cylinder = Cylinder(
        to_optical.apply(world.pipe.point), to_optical.rotate(world.pipe.direction), 0.3
    )
    return (frame.left_segments, frame.right_segments)[number], cylinder


def off(line: Array, true: Array) -> float:
    """Largest distance between two lines at the borders of the picture, px."""
    along = np.array([-true[1], true[0]])
    foot = -true[2] * true[:2]
    middle = foot + along * ((np.array([599.5, 399.5]) - foot) @ along)
    ends = middle + np.array([[-350.0], [350.0]]) * along
    return float(np.abs(ends @ line[:2] + line[2]).max())


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("heading", HEADINGS)
def test_both_contours_are_among_the_first_candidates(heading: float, number: int) -> None:
    segments, cylinder = scene(heading, number)
    camera = RIG.cameras[number]
    lines = contour_candidates(segments, camera)
    for true in outline_lines(cylinder, camera):
        # Ends are uncertain by 0.4 px each, a bundle of ten segments by less.
        assert min(off(found.line, true) for found in lines[:4]) < 2.0
    weights = [found.weight for found in lines]
    assert weights == sorted(weights, reverse=True)
    assert len(lines) <= 12


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("heading", HEADINGS)
def test_one_of_the_pairs_is_the_pipe(heading: float, number: int) -> None:
    segments, cylinder = scene(heading, number)
    camera = RIG.cameras[number]
    pairs = pair_hypotheses(contour_candidates(segments, camera), camera, 0.3, GREY)

    def wrong(axis: Axis) -> float:
        place = axis.point + axis.direction * ((cylinder.point - axis.point) @ axis.direction)
        turn = np.linalg.norm(np.cross(axis.direction, cylinder.direction))
        return cylinder.distance(place) + float(turn)

    errors = [wrong(axis) for axis, _ in pairs]
    best = int(np.argmin(errors))
    # A pixel of 280 px of width is 0.7 cm of 2 m of distance.
    assert errors[best] < 0.05
    # And it is the heaviest of all pairs.
    assert pairs[best][1] == max(weight for _, weight in pairs)


def test_the_radius_bounds_the_distance_of_a_pair() -> None:
    lines = [HoughLine(np.array([1.0, 0.0, -x]), 100.0) for x in (400.0, 404.0, 560.0, 700.0)]
    # 4 px of width: a pipe 140 m away; 300 px: 2 m; a pipe of 4 cm is never so wide.
    axes = [axis for axis, _ in pair_hypotheses(lines, LEFT, 0.3, GREY)]
    distances = sorted(float(np.linalg.norm(axis.point)) for axis in axes)
    assert len(axes) == 5
    assert distances[0] > 1.2 * 0.3
    assert distances[-1] < 40.0 * 0.6
    assert pair_hypotheses(lines[:2], LEFT, 0.3, GREY) == []


def test_lines_that_cross_are_no_pair() -> None:
    upright, level = np.array([1.0, 0.0, -600.0]), np.array([0.0, 1.0, -400.0])
    pair = [HoughLine(upright, 100.0), HoughLine(level, 100.0)]
    assert pair_hypotheses(pair, LEFT, 0.3, GREY) == []


def test_no_segments_give_no_candidates() -> None:
    none = np.zeros((0, 4), np.float32)
    assert contour_candidates(none, LEFT) == []
    assert pair_hypotheses([], LEFT, 0.3, GREY) == []


# Shadows.


def strip(level: int, noise: float = 2.0, beside: int = 120) -> Image:
    """A thumbnail with a strip between x = 400 and x = 720 of the full picture."""
    random = np.random.default_rng(1)
    small = np.full((100, 150), float(beside))
    small[:, 50:90] = level
    small += noise * random.normal(size=small.shape)
    return np.asarray(np.clip(small, 0, 255), np.uint8)


FIRST, SECOND = np.array([1.0, 0.0, -399.5]), np.array([1.0, 0.0, -719.5])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_dark_and_empty_strip_is_a_shadow(sign: float) -> None:
    assert is_shadow(FIRST, sign * SECOND, strip(40), 8.0)
    assert is_shadow(sign * SECOND, FIRST, strip(40), 8.0)


def test_a_strip_as_bright_as_its_neighbours_is_none() -> None:
    assert not is_shadow(FIRST, SECOND, strip(110), 8.0)
    assert not is_shadow(FIRST, SECOND, strip(200), 8.0)


def test_a_dark_strip_with_structure_is_a_dark_pipe() -> None:
    assert not is_shadow(FIRST, SECOND, strip(40, noise=12.0), 8.0)


def test_dark_on_one_side_only_is_none() -> None:
    thumbnail = strip(40)
    thumbnail[:, 90:] = 40
    assert not is_shadow(FIRST, SECOND, thumbnail, 8.0)


def test_without_a_thumbnail_or_room_nothing_is_a_shadow() -> None:
    assert not is_shadow(FIRST, SECOND, np.zeros((0, 0), np.uint8), 8.0)
    narrow = np.array([1.0, 0.0, -401.0])
    assert not is_shadow(FIRST, narrow, strip(40), 8.0)


def test_a_pair_round_a_shadow_is_dropped() -> None:
    lines = [HoughLine(FIRST, 100.0), HoughLine(SECOND, 100.0)]
    assert len(pair_hypotheses(lines, LEFT, 0.3, strip(120))) == 1
    assert pair_hypotheses(lines, LEFT, 0.3, strip(40)) == []


def plain_shadow(first: Array, second: Array, thumbnail: Image) -> bool:
    """Whether the strip between two lines is a shadow, written out with whole arrays."""
    ys, xs = np.mgrid[0 : thumbnail.shape[0], 0 : thumbnail.shape[1]]
    x, y = 8.0 * xs + 3.5, 8.0 * ys + 3.5
    a = first[0] * x + first[1] * y + first[2]
    b = second[0] * x + second[1] * y + second[2]
    if float(first[:2] @ second[:2]) < 0:
        b = -b
    low, high = np.minimum(a, b), np.maximum(a, b)
    inside = (low < 0) & (high > 0)
    width = np.median((high - low)[inside]) if inside.any() else 0.0
    before = (high <= 0) & (high > -0.5 * width)
    after = (low >= 0) & (low < 0.5 * width)
    if inside.sum() < 12 or before.sum() < 12 or after.sum() < 12:
        return False
    strip = thumbnail[inside].astype(np.float64)
    beside = min(float(thumbnail[before].mean()), float(thumbnail[after].mean()))
    return bool(strip.mean() < 0.75 * beside and strip.std() < 0.08 * max(strip.mean(), 1.0))


def test_a_shadow_is_told_as_with_whole_arrays() -> None:
    random = np.random.default_rng(5)
    told = []
    for _ in range(200):
        theta, gap = random.uniform(0.0, np.pi), random.uniform(40.0, 300.0)
        normal = np.array([np.cos(theta), np.sin(theta)])
        c = -float(normal @ random.uniform([200.0, 150.0], [1000.0, 650.0]))
        first = np.array([*normal, c])
        second = random.choice([-1.0, 1.0]) * np.array([*normal, c - gap])
        ys, xs = np.mgrid[0:100, 0:150]
        a = normal[0] * (8.0 * xs + 3.5) + normal[1] * (8.0 * ys + 3.5) + c
        dark = (a > 0.0) & (a < gap)
        level = random.uniform(40.0, 110.0)
        noise = random.normal(0.0, random.uniform(0.0, 8.0), a.shape)
        thumbnail = np.clip(np.where(dark, level, 120.0) + noise, 0, 255).astype(np.uint8)
        told.append(is_shadow(first, second, thumbnail, 8.0))
        assert told[-1] == plain_shadow(first, second, thumbnail)
    assert 20 < sum(told) < 180
