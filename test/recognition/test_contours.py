"""Which contours: candidates and pairs of them (4.2.1 to 4.2.3)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from silhouettes import Cylinder, outline_lines
from synthetic_world import DOWN, LEFT, RIG, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.recognition.contours import contour_candidates, pair_hypotheses
from pipeline_tracker.recognition.hough import HoughLine

Array = NDArray[np.float64]

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
    pairs = pair_hypotheses(contour_candidates(segments, camera), camera, 0.3)

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
    axes = [axis for axis, _ in pair_hypotheses(lines, LEFT, 0.3)]
    distances = sorted(float(np.linalg.norm(axis.point)) for axis in axes)
    assert len(axes) == 5
    assert distances[0] > 1.2 * 0.3
    assert distances[-1] < 40.0 * 0.6
    assert pair_hypotheses(lines[:2], LEFT, 0.3) == []


def test_lines_that_cross_are_no_pair() -> None:
    upright, level = np.array([1.0, 0.0, -600.0]), np.array([0.0, 1.0, -400.0])
    pair = [HoughLine(upright, 100.0), HoughLine(level, 100.0)]
    assert pair_hypotheses(pair, LEFT, 0.3) == []


def test_no_segments_give_no_candidates() -> None:
    none = np.zeros((0, 4), np.float32)
    assert contour_candidates(none, LEFT) == []
    assert pair_hypotheses([], LEFT, 0.3) == []
