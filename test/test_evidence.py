"""What a vectorized pair says about an axis, against slow references and a known world."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_world import DOWN, EXACT, LEFT, RIG, Diver, Pipe, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import (
    contour_rays,
    distances_from_axis,
    gather,
    rays_to_axis,
    unit_rays,
)
from pipeline_tracker.face import exposed_points, on_face, point_sigmas
from pipeline_tracker.surface import triangulate

Array = NDArray[np.float64]

BENT = Axis(
    np.array([0.1, -0.1, 2.0]),
    np.array([0.6, 0.8, 0.0]),
    np.array([-0.8, 0.6, 0.0]) / 40.0 + np.array([0.0, 0.0, 0.01]),
)
CURVE = np.array([BENT.at(t) for t in np.linspace(-3.0, 3.0, 60_001)])
RIGHT = RIG.cameras[1]


def axis_of(pipe: Pipe, at: Array | None = None) -> Axis:
    """The pipe's axis in the left optical frame of a vehicle at the origin of odom."""
    to_optical = DOWN.inverse()
    point = to_optical.apply(pipe.point if at is None else at)
    axis = Axis.straight(point, to_optical.rotate(pipe.direction))
    return Axis(axis.point, axis.direction, pipe.curvature * to_optical.rotate(pipe.left))


def abreast(pipe: Pipe) -> Axis:
    """The same, its origin nearest the camera."""
    axis = axis_of(pipe)
    return axis.moved(float(-axis.point @ axis.direction))


def test_distances_from_a_bent_axis_agree_with_a_slow_reference() -> None:
    random = np.random.default_rng(1)
    points = BENT.at(0.0) + random.uniform(-1.2, 1.2, (30, 3))
    normals, distance = distances_from_axis(points, BENT)
    for point, normal, found in zip(points, normals, distance, strict=True):
        away = point - CURVE
        length = np.linalg.norm(away, axis=1)
        nearest = int(np.argmin(length))
        assert found == pytest.approx(length[nearest], abs=1e-4)
        assert normal @ (away[nearest] / length[nearest]) > 0.9999


@pytest.mark.parametrize("camera", [LEFT, RIGHT], ids=["left", "right"])
def test_rays_to_a_bent_axis_agree_with_a_slow_reference(camera: object) -> None:
    view = LEFT if camera is LEFT else RIGHT
    random = np.random.default_rng(2)
    pixels = random.uniform([100.0, 100.0], [1100.0, 700.0], (30, 2))
    rays = unit_rays(pixels, view)
    assert np.allclose(np.linalg.norm(rays, axis=1), 1.0)
    measured = rays_to_axis(rays, view, BENT)
    origin = np.array([view.offset, 0.0, 0.0])
    away = CURVE - origin
    for ray, (aside, depth, t) in zip(rays, measured, strict=True):
        off = away - np.outer(away @ ray, ray)
        nearest = int(np.argmin(np.linalg.norm(off, axis=1)))
        if nearest in {0, len(CURVE) - 1}:
            continue
        assert abs(aside) == pytest.approx(np.linalg.norm(off[nearest]), abs=1e-4)
        assert depth == pytest.approx(away[nearest] @ ray, abs=1e-3)
        assert t == pytest.approx(-3.0 + 6.0 * nearest / 60_000, abs=1e-3)
        # Positive: to the right of travel, seen with the camera above.
        tangent = CURVE[nearest] - CURVE[nearest - 1]
        rightward = np.cross(tangent, -away[nearest])
        if abs(aside) > 1e-3:
            assert (aside > 0.0) == (-off[nearest] @ rightward > 0.0)


def test_no_rays_are_measured_too() -> None:
    assert rays_to_axis(np.zeros((0, 3)), LEFT, BENT).shape == (0, 3)


@pytest.mark.parametrize("heading", [0.0, 0.8, 1.57, 2.6])
def test_the_face_is_what_lies_on_the_pipe_in_the_picture(heading: float) -> None:
    world = World.with_pipe(heading=heading)
    diver = Diver(world, look=EXACT)
    frame = diver.frame(level_pose())
    surface = triangulate(frame.matches, RIG)
    assert world.pipe is not None
    axis = abreast(world.pipe)
    mask = on_face(surface, LEFT, axis, 0.3)
    off = np.abs(world.pipe.from_axis(DOWN.apply(surface.points)) - 0.3)
    # All of it is pipe; within the span of the fit and off the contours nearly all pipe is in it.
    assert off[mask].max() < 1e-3
    along = np.abs((surface.points - axis.point) @ axis.direction)
    normals, _ = distances_from_axis(surface.points, axis)
    facing = -np.einsum("ij,ij->i", normals, surface.rays)
    inner = (off < 1e-3) & (along < 1.5) & (facing > 0.5)
    assert mask[inner].mean() > 0.98
    assert mask.sum() > 50


def test_the_face_says_nothing_of_depth() -> None:
    # Where there is no pipe the bed fills its place.
    frame = Diver(World(World.with_pipe().bed), look=EXACT).frame(level_pose())
    pipe = World.with_pipe().pipe
    assert pipe is not None
    assert on_face(triangulate(frame.matches, RIG), LEFT, abreast(pipe), 0.3).sum() > 50


def test_a_point_is_less_sure_the_more_it_looks_at_the_camera() -> None:
    frame = Diver(World.with_pipe(height=3.0), look=EXACT).frame(level_pose())
    pipe = World.with_pipe(height=3.0).pipe
    assert pipe is not None
    axis = abreast(pipe)
    surface = triangulate(frame.matches, RIG)
    face = surface.subset(on_face(surface, LEFT, axis, 0.3))
    sigmas = point_sigmas(face, axis)
    # Across the ray of the middle the depth counts in full, at the limb by a part.
    normals, _ = distances_from_axis(face.points, axis)
    facing = -np.einsum("ij,ij->i", normals, face.rays)
    top = facing > 0.99
    assert top.sum() > 5
    assert np.allclose(sigmas[top], np.hypot(face.depth_sigmas[top], 0.003), rtol=0.02)
    assert sigmas[facing < 0.7].mean() < sigmas[top].mean()


@pytest.mark.parametrize("view", [LEFT, RIGHT], ids=["left", "right"])
def test_segments_along_a_contour_are_found_and_told_by_side(view: object) -> None:
    camera, number = (LEFT, 0) if view is LEFT else (RIGHT, 1)
    world = World.with_pipe(heading=0.4, aside=0.1)
    assert world.pipe is not None
    axis = abreast(world.pipe)
    frame = Diver(world, look=EXACT).frame(level_pose())
    segments = (frame.left_segments, frame.right_segments)[number]
    rays, sides, weights = contour_rays(segments, camera, axis, 0.3, 5.0)
    assert len(rays) == len(sides) == len(weights)
    assert len(rays) >= 0.9 * 2 * len(segments)
    measured = rays_to_axis(rays, camera, axis)
    assert np.abs(measured[:, 0] - 0.3 * sides).max() < 1e-4
    assert (sides == -1).any()
    assert (sides == 1).any()
    # By length; but a contour, however long, counts as four independent sights of it.
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).astype(np.float64).T)
    for side in (-1, 1):
        own = sides[::2] == side
        assert weights[::2][own] / weights[::2][own].sum() == pytest.approx(
            length[own] / length[own].sum(), rel=1e-5
        )
        assert 2.0 * weights[::2][own].sum() == pytest.approx(4.0)


def test_segments_that_are_far_or_steep_are_left_out() -> None:
    world = World.with_pipe()
    assert world.pipe is not None
    axis = abreast(world.pipe)
    frame = Diver(world, look=EXACT).frame(level_pose())
    near = frame.left_segments
    count = len(contour_rays(near, LEFT, axis, 0.3, 5.0)[0])
    assert count > 0
    # The pipe runs up the picture: to the side is along x.
    aside = near + np.array([4.0, 0.0, 4.0, 0.0], np.float32)
    assert len(contour_rays(aside, LEFT, axis, 0.3, 5.0)[0]) == count
    far = near + np.array([6.0, 0.0, 6.0, 0.0], np.float32)
    assert len(contour_rays(far, LEFT, axis, 0.3, 5.0)[0]) == 0
    # Turned by 0.2 rad about their middles, made short so that both ends stay near.
    middle = 0.5 * (near[:, :2] + near[:, 2:])
    half = 0.5 * (near[:, 2:] - near[:, :2])
    half = 12.0 * half / np.hypot(half[:, 0], half[:, 1])[:, None]
    c, s = math.cos(0.2), math.sin(0.2)
    turned = half @ np.array([[c, s], [-s, c]], np.float32)
    steep = np.column_stack((middle - turned, middle + turned)).astype(np.float32)
    assert len(contour_rays(steep, LEFT, axis, 0.3, 5.0)[0]) == 0
    assert len(contour_rays(near[:0], LEFT, axis, 0.3, 5.0)[0]) == 0


def test_evidence_is_gathered_from_both_images() -> None:
    world = World.with_pipe(heading=0.4)
    assert world.pipe is not None
    axis = abreast(world.pipe)
    frame = Diver(world, look=EXACT).frame(level_pose())
    found = gather(frame, triangulate(frame.matches, RIG), axis, 0.3, 5.0)
    assert len(found.points) == len(found.point_sigmas) > 50
    sizes = {len(a) for a in (found.rays, found.origins, found.sides, found.ray_sigmas)}
    assert sizes == {len(found.ray_weights)}
    assert set(found.origins[:, 0].tolist()) == {0.0, 0.2}
    # Points of a surface that tells nothing are no evidence.
    few = triangulate(frame.matches[::40], RIG)
    assert len(gather(frame, few, axis, 0.3, 5.0).points) == 0


def test_what_lies_on_the_pipe_covers_its_section_and_no_other() -> None:
    world = World.with_pipe()
    assert world.pipe is not None
    axis = abreast(world.pipe)
    surface = triangulate(Diver(world, look=EXACT).frame(level_pose()).matches, RIG)
    assert exposed_points(surface, LEFT, axis, 0.3).all()
    along = (surface.points - axis.point) @ axis.direction
    face = on_face(surface, LEFT, axis, 0.3)
    # A heap of 3 cm on the pipe over 0.6 m.
    heap = face & (along > 0.4) & (along < 1.0)
    lifted = surface.points - 0.03 * heap[:, None] * surface.rays
    covered = replace(surface, points=lifted)
    exposed = exposed_points(covered, LEFT, axis, 0.3)
    assert not exposed[heap & (along > 0.6) & (along < 0.8)].any()
    assert exposed[(along < 0.15) | (along > 1.25)].all()


def test_silt_that_rises_through_the_pipe_covers_it() -> None:
    # Of the points on the slope a good half are near the pipe's surface, a little below and above.
    world = World.with_pipe()
    assert world.pipe is not None
    axis = abreast(world.pipe)
    surface = triangulate(Diver(world, look=EXACT).frame(level_pose()).matches, RIG)
    along = (surface.points - axis.point) @ axis.direction
    slope = on_face(surface, LEFT, axis, 0.3) & (along > 0.4) & (along < 1.0)
    sigmas = point_sigmas(surface, axis)
    rise = np.random.default_rng(3).permutation(np.linspace(-4.5, 4.5, int(slope.sum())))
    lifted = surface.points.copy()
    lifted[slope] -= (rise * sigmas[slope])[:, None] * surface.rays[slope]
    exposed = exposed_points(replace(surface, points=lifted), LEFT, axis, 0.3)
    middle = slope & (along > 0.6) & (along < 0.8)
    assert 0.5 < np.mean(np.abs(rise[middle[slope]]) < 3.0) < 0.75
    assert not exposed[middle].any()
    assert exposed[(along < 0.15) | (along > 1.25)].all()
