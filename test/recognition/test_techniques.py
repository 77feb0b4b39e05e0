"""Techniques 1 to 3 against a densely sampled cylinder, which knows nothing of tangent planes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from silhouettes import Cylinder, outline_lines, outlines, pixels_of

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.recognition.techniques import (
    LEAST_PLANE_ANGLE,
    clip_image_line,
    oriented_planes,
    tangent_plane,
    technique1,
    technique2,
    technique3,
)

Array = NDArray[np.float64]

LEFT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800)
RIGHT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800, offset=0.2)
RIG = StereoRig(LEFT, RIGHT)
UP = np.array([0.0, 0.0, -1.0])

# A ring of 20000 generatrices misses the tangent by at most 1.6e-4 rad of turn round the axis,
# that is r * 1.2e-8 across the line of sight: what is left is rounding.
EXACT = 1e-6


def off_axis(axis: Axis, cylinder: Cylinder) -> tuple[float, float]:
    """Distance of two places of an axis, 1 m apart, from the true one, m, and the turn, rad."""
    place = axis.point + axis.direction * ((cylinder.point - axis.point) @ axis.direction)
    distance = max(cylinder.distance(place + t * axis.direction) for t in (-0.5, 0.5))
    return distance, float(np.linalg.norm(np.cross(axis.direction, cylinder.direction)))


def angle_between_medians(cylinder: Cylinder) -> float:
    """Angle at which the planes through the axis and each camera's centre meet, rad."""
    normals = []
    for camera in RIG.cameras:
        away = cylinder.point - np.array([camera.offset, 0.0, 0.0])
        normal = np.cross(away, cylinder.direction)
        normals.append(normal / np.linalg.norm(normal))
    return float(np.arcsin(np.linalg.norm(np.cross(*normals))))


@st.composite
def cylinders(draw: st.DrawFn) -> Cylinder:
    """A pipe in view: any heading, up to 30 degrees out of the image plane, 1.2 to 5 m away.

    It does not fill either picture: an edge of it is seen.
    """
    cylinder = Cylinder.seen(
        np.array([draw(st.floats(350.0, 850.0)), draw(st.floats(250.0, 550.0))]),
        depth=draw(st.floats(1.2, 5.0)),
        heading=draw(st.floats(0.0, 2.0 * math.pi)),
        tilt=draw(st.floats(-0.5, 0.5)),
        radius=draw(st.floats(0.05, 0.5)),
        camera=LEFT,
    )
    for camera in RIG.cameras:
        assume(cylinder.distance(np.array([camera.offset, 0.0, 0.0])) > 1.5 * cylinder.radius)
        lines = outline_lines(cylinder, camera)
        assume(any(clip_image_line(line, 1200, 800) is not None for line in lines))
    return cylinder


# Technique 2.


@given(cylinders(), st.sampled_from([LEFT, RIGHT]))
@settings(max_examples=100)
def test_technique_2_finds_the_axis_of_any_cylinder_in_view(
    cylinder: Cylinder, camera: Camera
) -> None:
    left, right = outline_lines(cylinder, camera)
    axis = technique2(left, right, camera, cylinder.radius)
    assert axis is not None
    distance, turn = off_axis(axis, cylinder)
    assert distance < EXACT
    assert turn < EXACT


@pytest.mark.parametrize("camera", RIG.cameras, ids=["left", "right"])
@pytest.mark.parametrize("tilt", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("degrees", [0, 1, 45, 89, 90, 91, 135, 179, 180, 181, 270, 359])
def test_technique_2_has_no_blind_heading(degrees: int, tilt: float, camera: Camera) -> None:
    # Along the columns, along the rows, and where the normal's angle goes from pi back to 0.
    cylinder = Cylinder.seen(
        np.array([640.0, 380.0]), 2.0, math.radians(degrees), tilt, 0.3, camera=LEFT
    )
    axis = technique2(*outline_lines(cylinder, camera), camera, 0.3)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < EXACT


@given(cylinders(), st.booleans(), st.booleans(), st.booleans())
@settings(max_examples=20)
def test_technique_2_needs_neither_the_lines_order_nor_their_sign(
    cylinder: Cylinder, swap: bool, flip_left: bool, flip_right: bool
) -> None:
    left, right = outline_lines(cylinder, LEFT)
    left, right = (-left if flip_left else left), (-right if flip_right else right)
    if swap:
        left, right = right, left
    axis = technique2(left, right, LEFT, cylinder.radius)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < EXACT


def far_forward(degrees: float) -> Cylinder:
    """A pipe below a camera that looks along it, ``degrees`` away from straight down."""
    tilt = math.radians(degrees)
    direction = np.array([0.05, -math.cos(tilt), math.sin(tilt)])
    direction /= np.linalg.norm(direction)
    below = np.cross([1.0, 0.0, 0.0], direction)
    below *= -np.sign(below[1]) / np.linalg.norm(below)
    return Cylinder(-2.0 * below, direction, 0.3)


@pytest.mark.parametrize("degrees", [50, 60, 70, 80, 89])
def test_technique_2_holds_for_a_camera_that_looks_far_forward(degrees: int) -> None:
    cylinder = far_forward(degrees)
    axis = technique2(*outline_lines(cylinder, LEFT), LEFT, 0.3)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < EXACT


@pytest.mark.parametrize("degrees", [89, 91, 95, 100])
def test_technique_2_takes_an_axis_whose_nearest_place_is_behind_the_camera(degrees: int) -> None:
    # The contours meet in the picture; where the pipe is seen tells it from one overhead.
    cylinder = far_forward(degrees)
    assert (cylinder.point[2] < 0.0) == (degrees > 90)
    seen = pixels_of((cylinder.point + 10.0 * cylinder.direction)[None], LEFT)[0]
    assert 400.0 < seen[1] < 800.0
    axis = technique2(*outline_lines(cylinder, LEFT), LEFT, 0.3, seen)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < EXACT


def test_technique_2_refuses_parallel_planes_and_lines_outside_the_picture() -> None:
    line = np.array([1.0, 0.0, -300.0])
    assert technique2(line, line, LEFT, 0.3) is None
    outside = np.array([1.0, 0.0, 300.0]), np.array([1.0, 0.0, 400.0])
    assert technique2(*outside, LEFT, 0.3) is None


def test_technique_2_needs_only_one_line_inside_the_picture() -> None:
    # The pipe leaves the picture at its left border: only its right contour is in it.
    cylinder = Cylinder.seen(np.array([10.0, 400.0]), 2.0, math.pi / 2.0, 0.0, 0.3, camera=LEFT)
    left, right = outline_lines(cylinder, LEFT)
    inside = [clip_image_line(line, 1200, 800) is not None for line in (left, right)]
    assert sum(inside) == 1
    axis = technique2(left, right, LEFT, 0.3)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < EXACT


# Planes.


@given(cylinders(), st.sampled_from([LEFT, RIGHT]))
@settings(max_examples=30)
def test_the_normals_of_both_planes_point_the_same_way_across(
    cylinder: Cylinder, camera: Camera
) -> None:
    normals = oriented_planes(*outline_lines(cylinder, camera), camera)
    assert normals is not None
    n_left, n_right = normals
    # In the plane across the axis, where the pipe is a disc: both from its right to its left.
    centre = np.array([camera.offset, 0.0, 0.0])
    away = cylinder.point - centre
    away -= cylinder.direction * (away @ cylinder.direction)
    rightward = np.cross(cylinder.direction, -away)
    assert n_left @ rightward < 0.0
    assert n_right @ rightward < 0.0
    # The disc touches both planes: its centre is one radius on either side of them.
    assert abs(n_left @ away + cylinder.radius) < EXACT
    assert abs(n_right @ away - cylinder.radius) < EXACT


@given(cylinders(), st.sampled_from([LEFT, RIGHT]))
@settings(max_examples=20)
def test_a_tangent_plane_holds_the_outline_and_the_camera(
    cylinder: Cylinder, camera: Camera
) -> None:
    for line, ends in zip(outline_lines(cylinder, camera), outlines(cylinder, camera), strict=True):
        normal = tangent_plane(line, camera)
        assert math.isclose(np.linalg.norm(normal), 1.0, abs_tol=1e-12)
        assert np.abs((ends - [camera.offset, 0.0, 0.0]) @ normal).max() < EXACT


# Technique 3.


@given(cylinders())
@settings(max_examples=50)
def test_technique_3_finds_the_axis_where_the_median_planes_meet(cylinder: Cylinder) -> None:
    angle = angle_between_medians(cylinder)
    assume(abs(angle - LEAST_PLANE_ANGLE) > 1e-4)
    pairs = [outline_lines(cylinder, camera) for camera in RIG.cameras]
    axis = technique3(pairs[0], pairs[1], RIG)
    if angle < LEAST_PLANE_ANGLE:
        assert axis is None
    else:
        assert axis is not None
        assert off_axis(axis, cylinder)[0] < 1e-4
        assert off_axis(axis, cylinder)[1] < 1e-4


@pytest.mark.parametrize("degrees", [0, 5, 10, 170, 175, 180])
def test_technique_3_is_refused_for_a_pipe_along_the_baseline(degrees: int) -> None:
    cylinder = Cylinder.seen(
        np.array([600.0, 400.0]), 2.0, math.radians(degrees), 0.0, 0.3, camera=LEFT
    )
    pairs = [outline_lines(cylinder, camera) for camera in RIG.cameras]
    assert technique3(pairs[0], pairs[1], RIG) is None


@pytest.mark.parametrize("degrees", [40, 60, 90, 120, 140])
def test_technique_3_takes_a_pipe_across_the_baseline(degrees: int) -> None:
    cylinder = Cylinder.seen(
        np.array([600.0, 400.0]), 2.0, math.radians(degrees), 0.1, 0.3, camera=LEFT
    )
    pairs = [outline_lines(cylinder, camera) for camera in RIG.cameras]
    axis = technique3(pairs[0], pairs[1], RIG)
    assert axis is not None
    assert max(off_axis(axis, cylinder)) < 1e-5


def test_technique_3_needs_two_cameras() -> None:
    cylinder = Cylinder.seen(np.array([600.0, 400.0]), 2.0, 1.5, 0.0, 0.3, camera=LEFT)
    pair = outline_lines(cylinder, LEFT)
    assert technique3(pair, pair, StereoRig(LEFT, None)) is None


# Technique 1.


def face(cylinder: Cylinder, count: int, random: np.random.Generator) -> Array:
    """Points (N, 3) of the part of the surface that faces the left camera."""
    d = cylinder.direction
    near = -cylinder.point + d * (cylinder.point @ d)
    near /= np.linalg.norm(near)
    side = np.cross(d, near)
    angle = random.uniform(-1.2, 1.2, (count, 1))
    along = random.uniform(-1.0, 1.0, (count, 1))
    ring = np.cos(angle) * near + np.sin(angle) * side
    return np.asarray(cylinder.point + along * d + cylinder.radius * ring)


@given(cylinders(), st.integers(0, 1000))
@settings(max_examples=30)
def test_technique_1_finds_the_axis_from_exact_surface_points(
    cylinder: Cylinder, seed: int
) -> None:
    points = face(cylinder, 60, np.random.default_rng(seed))
    axis = technique1(points, np.full(60, 0.005), cylinder.direction, cylinder.radius, UP)
    assert axis is not None
    assert off_axis(axis, cylinder)[0] < EXACT
    # It lies beyond the points, not on the camera's side of them.
    assert np.linalg.norm(np.cross(axis.point, axis.direction)) > np.min(
        np.linalg.norm(np.cross(points, cylinder.direction), axis=1)
    )


@pytest.mark.parametrize("bed_points", [30, 100])
@pytest.mark.parametrize("degrees", [0, 30, 90, 150, 200, 270])
def test_technique_1_is_robust_against_points_of_the_bed(degrees: int, bed_points: int) -> None:
    random = np.random.default_rng(degrees)
    cylinder = Cylinder.seen(
        np.array([600.0, 400.0]), 2.0, math.radians(degrees), 0.1, 0.3, camera=LEFT
    )
    points = face(cylinder, 120, random) + random.normal(0.0, 0.003, (120, 3))
    side = np.cross(cylinder.direction, UP)
    sides = random.choice([-1.0, 1.0], (bed_points, 1))
    offsets = sides * random.uniform(0.4, 0.8, (bed_points, 1))
    along = random.uniform(-1.0, 1.0, (bed_points, 1)) * cylinder.direction
    bed = cylinder.point + along + offsets * side + [0.0, 0.0, 0.3]
    both = np.concatenate((points, bed))
    axis = technique1(both, np.full(len(both), 0.005), cylinder.direction, 0.3, UP)
    assert axis is not None
    # Noise of 3 mm on 120 points leaves about 0.5 mm; the bed, up to 45 % of all, adds little.
    assert off_axis(axis, cylinder)[0] < 0.005


def test_technique_1_takes_a_vertical_direction_too() -> None:
    cylinder = Cylinder(np.array([0.1, 0.2, 2.0]), np.array([0.0, 1.0, 0.0]), 0.3)
    points = face(cylinder, 60, np.random.default_rng(1))
    axis = technique1(points, np.full(60, 0.005), cylinder.direction, 0.3, cylinder.direction)
    assert axis is not None
    assert off_axis(axis, cylinder)[0] < EXACT


def test_technique_1_needs_three_points() -> None:
    assert technique1(np.ones((2, 3)), np.ones(2), np.array([1.0, 0.0, 0.0]), 0.3, UP) is None


# Clipping.


@given(
    st.floats(0.0, math.pi),
    st.floats(-900.0, 900.0),
)
@settings(max_examples=50)
def test_a_line_is_clipped_to_the_picture(theta: float, rho: float) -> None:
    normal = np.array([math.cos(theta), math.sin(theta)])
    line = np.array([*normal, -rho - normal @ [599.5, 399.5]])
    ends = clip_image_line(line, 1200, 800)
    # Independently: walk along the line in small steps and see which are inside.
    foot = np.array([599.5, 399.5]) + rho * normal
    steps = foot + np.linspace(-1500.0, 1500.0, 30_001)[:, None] * [-normal[1], normal[0]]
    inside = (np.abs(steps - [599.5, 399.5]) <= [600.0, 400.0]).all(axis=1)
    if ends is None:
        assert inside.sum() <= 1
        return
    assert np.abs(ends.reshape(2, 2) @ line[:2] + line[2]).max() < 1e-6
    if not inside.any():
        assert np.hypot(*(ends[2:] - ends[:2])) < 0.15
        return
    walked = steps[inside][[0, -1]]
    gap = min(
        np.abs(walked - ends.reshape(2, 2)).max(), np.abs(walked - ends.reshape(2, 2)[::-1]).max()
    )
    assert gap < 0.15


def test_pixels_of_agrees_with_a_hand_made_projection() -> None:
    # 0.5 m to the right and 0.2 m down at 2 m: 930 * 0.25 right, 925 * 0.1 down.
    assert np.allclose(pixels_of(np.array([[0.5, 0.2, 2.0]]), LEFT), [[833.0, 492.0]])
    assert np.allclose(pixels_of(np.array([[0.5, 0.2, 2.0]]), RIGHT), [[740.0, 492.0]])
