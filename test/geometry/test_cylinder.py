"""Visible boundaries against a densely sampled cylinder, which knows nothing of tangents."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import (
    boundary_in_view,
    clip_line_to_view,
    contour_lines,
    nearest_point,
    visible_generatrices,
)
from pipeline_tracker.geometry.pose import Pose

Array = NDArray[np.float64]

LEFT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800)
RIGHT = Camera(930.0, 925.0, 600.5, 399.5, 1200, 800, offset=0.2)
ROUND = 2000


def surface(point: Array, direction: Array, radius: float, half_length: float) -> Array:
    """Points of a cylinder's surface, (N, 3), from any two normals of its axis."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    angle = np.linspace(0.0, 2.0 * math.pi, ROUND, endpoint=False)[:, None]
    ring = point + radius * (np.cos(angle) * first + np.sin(angle) * second)
    along = np.linspace(-half_length, half_length, 5)[:, None]
    return np.concatenate([ring + t * direction for t in along])


@st.composite
def cylinders(draw: st.DrawFn) -> tuple[Array, Array, float]:
    """A cylinder before the camera, outside it, not seen end on."""
    point = np.array([draw(st.floats(-0.7, 0.7)), draw(st.floats(-0.5, 0.5)), 0.0])
    point[2] = draw(st.floats(1.5, 6.0))
    azimuth, tilt = draw(st.floats(0.0, 2.0 * math.pi)), draw(st.floats(-0.9, 0.9))
    direction = np.array(
        [math.cos(azimuth) * math.cos(tilt), math.sin(azimuth) * math.cos(tilt), math.sin(tilt)]
    )
    radius = draw(st.floats(0.05, 0.5))
    for camera in (LEFT, RIGHT):
        q = nearest_point(point, direction, camera.centre)
        assume(np.linalg.norm(q - camera.centre) > 1.3 * radius + 0.1)
    return point, direction, radius


def signed(line: Array, pixels: Array) -> Array:
    return np.asarray(pixels @ line[:2] + line[2])


@given(cylinders(), st.sampled_from([LEFT, RIGHT]))
def test_contours_are_the_border_of_the_sampled_silhouette(
    cylinder: tuple[Array, Array, float], camera: Camera
) -> None:
    point, direction, radius = cylinder
    lines = contour_lines(point, direction, radius, camera)
    assert lines is not None
    pixels = camera.project(surface(point, direction, radius, 0.4))
    axis_pixel = camera.project(point)
    # A chord of the sampled circle stays inside by less than this, in pixels.
    slack = 930.0 * radius * (1.0 - math.cos(math.pi / ROUND)) / 0.2
    for line in lines:
        assert math.hypot(line[0], line[1]) == pytest.approx(1.0)
        inside = signed(line, pixels) * np.sign(signed(line, axis_pixel))
        # The whole surface is on the axis's side of the line, and touches it.
        assert inside.min() > -1e-6
        assert inside.min() < slack + 0.02
    # The two lines bound it from opposite sides.
    assert not np.allclose(lines[0], lines[1])
    assert not np.allclose(lines[0], -lines[1])


@given(cylinders(), st.sampled_from([LEFT, RIGHT]))
def test_left_and_right_are_those_of_one_who_looks_along_the_pipe(
    cylinder: tuple[Array, Array, float], camera: Camera
) -> None:
    point, direction, radius = cylinder
    lines = contour_lines(point, direction, radius, camera)
    assert lines is not None
    # In the picture (y down), left of a walker with velocity (vx, vy) is (vy, -vx).
    here, there = camera.project(point), camera.project(point + 1e-4 * direction)
    v = (there - here) / np.linalg.norm(there - here)
    to_left = np.array([v[1], -v[0]])
    for line, side in zip(lines, (1.0, -1.0), strict=True):
        # Way from the axis to the contour, across the picture.
        way = -signed(line, here) / (line[:2] @ to_left)
        assert way * side > 0.0


def test_pipe_under_a_camera_that_looks_down() -> None:
    # Top of the picture forward: a pipe along travel leads to -y, its right contour lies at +x.
    lines = contour_lines(np.array([0.0, 0.0, 2.0]), np.array([0.0, -1.0, 0.0]), 0.3, LEFT)
    assert lines is not None
    reach = 930.0 * math.tan(math.asin(0.3 / 2.0))
    for line, x in zip(lines, (600.5 - reach, 600.5 + reach), strict=True):
        assert abs(line[0]) == pytest.approx(1.0)
        assert -line[2] / line[0] == pytest.approx(x)


@given(cylinders())
def test_turned_end_for_end_left_and_right_change_places(
    cylinder: tuple[Array, Array, float],
) -> None:
    point, direction, radius = cylinder
    there = visible_generatrices(point, direction, radius, RIGHT.centre)
    back = visible_generatrices(point, -direction, radius, RIGHT.centre)
    assert there is not None
    assert back is not None
    np.testing.assert_allclose(there[0], back[1], atol=1e-9)
    np.testing.assert_allclose(there[1], back[0], atol=1e-9)


@given(cylinders())
def test_mirrored_left_and_right_change_places(cylinder: tuple[Array, Array, float]) -> None:
    point, direction, radius = cylinder
    mirror = np.array([-1.0, 1.0, 1.0])
    there = visible_generatrices(point, direction, radius, LEFT.centre)
    mirrored = visible_generatrices(mirror * point, mirror * direction, radius, LEFT.centre)
    assert there is not None
    assert mirrored is not None
    np.testing.assert_allclose(mirror * mirrored[1], there[0], atol=1e-9)
    np.testing.assert_allclose(mirror * mirrored[0], there[1], atol=1e-9)


@given(
    cylinders(),
    st.tuples(*[st.floats(-20, 20)] * 3),
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.floats(-2.0, 2.0),
)
def test_moving_the_world_moves_the_boundaries(
    cylinder: tuple[Array, Array, float],
    translation: tuple[float, float, float],
    rpy: tuple[float, float, float],
    along: float,
) -> None:
    point, direction, radius = cylinder
    move = Pose.from_rpy(translation, rpy)
    still = visible_generatrices(point, direction, radius, RIGHT.centre)
    # Which point of the axis is given must not matter either.
    moved = visible_generatrices(
        move.apply(point + along * direction),
        move.rotate(direction),
        radius,
        move.apply(RIGHT.centre),
    )
    assert still is not None
    assert moved is not None
    for a, b in zip(still, moved, strict=True):
        np.testing.assert_allclose(move.apply(a), b, atol=1e-8)


@given(cylinders())
def test_generatrices_lie_on_the_surface_and_the_line_of_sight_touches_it(
    cylinder: tuple[Array, Array, float],
) -> None:
    point, direction, radius = cylinder
    edges = visible_generatrices(point, direction, radius, RIGHT.centre)
    assert edges is not None
    for edge in edges:
        foot = nearest_point(point, direction, edge)
        assert np.linalg.norm(edge - foot) == pytest.approx(radius)
        # Nowhere does the line of sight come nearer to the axis than the radius.
        sight = RIGHT.centre + np.linspace(0.0, 3.0, 30001)[:, None] * (edge - RIGHT.centre)
        off = (sight - point) - ((sight - point) @ direction)[:, None] * direction
        assert np.linalg.norm(off, axis=1).min() == pytest.approx(radius, rel=1e-6)


def test_inside_the_pipe_there_is_no_boundary() -> None:
    along = np.array([0.0, 1.0, 0.0])
    assert visible_generatrices(np.array([0.1, 0.0, 0.1]), along, 0.3, np.zeros(3)) is None
    assert contour_lines(np.array([0.1, 0.0, 0.1]), along, 0.3, LEFT) is None
    # On the surface itself neither.
    assert visible_generatrices(np.array([0.0, 0.0, 0.3]), along, 0.3, np.zeros(3)) is None


def test_nearest_point_against_a_search() -> None:
    point, direction = np.array([1.0, -2.0, 3.0]), np.array([2.0, 1.0, -0.5])
    origin = np.array([0.4, 0.7, -0.2])
    t = np.linspace(-5.0, 5.0, 200001)[:, None]
    line = point + t * direction
    best = line[np.argmin(np.linalg.norm(line - origin, axis=1))]
    np.testing.assert_allclose(nearest_point(point, direction, origin), best, atol=2e-4)


@given(cylinders(), st.floats(-100.0, 100.0))
def test_a_line_is_clipped_to_what_a_dense_sampling_sees(
    cylinder: tuple[Array, Array, float], margin: float
) -> None:
    point, direction, _ = cylinder
    t = np.linspace(-8.0, 8.0, 4001)
    line = point + t[:, None] * direction
    depth = line[:, 2]
    pixels = RIGHT.project(np.where(depth[:, None] > 0.05, line, [0.0, 0.0, 1.0]))
    seen = (
        (depth > 0.05)
        & (np.abs(pixels[:, 0] - 599.5) < 600.0 - margin)
        & (np.abs(pixels[:, 1] - 399.5) < 400.0 - margin)
    )
    clipped = clip_line_to_view(point, direction, RIGHT, near=0.05, margin=margin)
    if clipped is None:
        assert not seen.any()
        return
    inner = (t > clipped[0] + 1e-6) & (t < clipped[1] - 1e-6)
    outer = (t < clipped[0] - 1e-6) | (t > clipped[1] + 1e-6)
    assert seen[inner].all()
    assert not seen[outer].any()


def test_a_line_beside_the_view_is_clipped_away() -> None:
    assert clip_line_to_view(np.array([5.0, 0.0, 2.0]), np.array([0.0, 1.0, 0.0]), LEFT) is None
    assert clip_line_to_view(np.array([0.0, 0.0, -2.0]), np.array([0.0, 1.0, 0.0]), LEFT) is None


def test_a_line_to_its_vanishing_point_has_an_infinite_end() -> None:
    clipped = clip_line_to_view(np.array([0.1, 0.0, 2.0]), np.array([0.0, 0.0, 1.0]), LEFT)
    assert clipped is not None
    assert clipped[1] == math.inf


@pytest.mark.parametrize("camera", [LEFT, RIGHT], ids=["left", "right"])
@given(cylinder=cylinders())
def test_a_boundary_in_view_is_the_generatrix_clipped_and_projected(
    camera: Camera, cylinder: tuple[Array, Array, float]
) -> None:
    point, direction, radius = cylinder
    edges = visible_generatrices(point, direction, radius, camera.centre)
    assume(edges is not None)
    assert edges is not None
    for side, edge in zip((-1.0, 1.0), edges, strict=True):
        line = np.empty(4)
        seen = boundary_in_view(point, direction, radius, side, camera.numbers, -1.5, 2.0, line)
        start = edge + direction * float((point - edge) @ direction)
        view = clip_line_to_view(start, direction, camera)
        low, high = (0.0, 0.0) if view is None else (max(view[0], -1.5), min(view[1], 2.0))
        assert seen == (low < high)
        if seen:
            ends = camera.project(np.stack((start + low * direction, start + high * direction)))
            assert np.allclose(line, ends.reshape(4), atol=1e-6)


def test_a_camera_inside_the_pipe_sees_no_boundary() -> None:
    line = np.empty(4)
    along = np.array([0.0, 1.0, 0.0])
    for side in (-1.0, 1.0):
        assert not boundary_in_view(
            np.array([0.1, 0.0, 0.1]), along, 0.3, side, LEFT.numbers, -9.0, 9.0, line
        )
