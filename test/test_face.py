"""Points on the pipe's face: compiled passes against plain ones, written out with NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_world import DOWN, LEFT, RIG, Diver, Look, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import distances_from_axis, rays_to_axis
from pipeline_tracker.face import (
    FACE_SHARE,
    ROUGHNESS,
    SPAN,
    face_evidence,
    on_face,
    point_sigmas,
    without_sag,
)
from pipeline_tracker.surface import SurfacePoints, triangulate
from pipeline_tracker.vectorization.patch_alignment import patch_variance

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def scene() -> tuple[SurfacePoints, Axis]:
    world = World.with_pipe(heading=0.4, aside=0.1, curvature=0.03)
    frame = Diver(world, look=Look()).frame(level_pose(), seed=2)
    assert world.pipe is not None
    to_optical = DOWN.inverse()
    axis = Axis(
        to_optical.apply(world.pipe.point),
        to_optical.rotate(world.pipe.direction),
        0.03 * to_optical.rotate(world.pipe.left),
    )
    return triangulate(frame.matches, RIG), axis.moved(float(-axis.point @ axis.direction))


def plain_face(surface: SurfacePoints, axis: Axis) -> NDArray[np.bool_]:
    measured = rays_to_axis(surface.rays, LEFT, axis)
    # 10 px before the contour.
    margin = np.minimum(0.3 - 10.0 * measured[:, 1] / LEFT.fx, 0.3 * FACE_SHARE)
    seen = (np.abs(measured[:, 0]) < margin) & (measured[:, 1] > 0.0)
    return np.asarray(seen & (np.abs(measured[:, 2]) < SPAN), np.bool_)


def plain_without_sag(surface: SurfacePoints, axis: Axis) -> Array:
    aside = rays_to_axis(surface.rays, LEFT, axis)[:, 0]
    facing = np.maximum(1.0 - np.square(aside / 0.3), 0.1)
    sag = 0.5 * patch_variance() * np.square(surface.points[:, 2] / LEFT.fx) / (0.3 * facing)
    normals, _ = distances_from_axis(surface.points, axis)
    return np.asarray(surface.points + sag[:, None] * normals)


def plain_sigmas(surface: SurfacePoints, axis: Axis) -> Array:
    normals, _ = distances_from_axis(surface.points, axis)
    facing = np.abs(np.einsum("ij,ij->i", normals, surface.rays))
    return np.hypot(surface.depth_sigmas * np.maximum(facing, 0.2), ROUGHNESS)


def test_each_pass_agrees_with_a_plain_one(scene: tuple[SurfacePoints, Axis]) -> None:
    surface, axis = scene
    mask = on_face(surface, LEFT, axis, 0.3)
    assert np.array_equal(mask, plain_face(surface, axis))
    assert 50 < mask.sum() < len(mask)
    face = surface.subset(mask)
    assert np.allclose(without_sag(face, LEFT, axis, 0.3).points, plain_without_sag(face, axis))
    assert np.allclose(point_sigmas(surface, axis), plain_sigmas(surface, axis))


def test_the_evidence_is_what_the_passes_give_one_after_the_other(
    scene: tuple[SurfacePoints, Axis],
) -> None:
    surface, axis = scene
    face = surface.subset(on_face(surface, LEFT, axis, 0.3))
    points, sigmas = face_evidence(surface, LEFT, axis, 0.3)
    placed = without_sag(face, LEFT, axis, 0.3)
    assert np.allclose(points, placed.points)
    assert np.allclose(sigmas, point_sigmas(placed, axis))


def test_a_face_that_tells_no_shape_is_no_evidence(scene: tuple[SurfacePoints, Axis]) -> None:
    surface, axis = scene
    few = surface.subset(np.arange(len(surface.points)) % 40 == 0)
    points, sigmas = face_evidence(few, LEFT, axis, 0.3)
    assert len(points) == len(sigmas) == 0
