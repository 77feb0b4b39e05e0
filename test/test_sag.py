"""Matched points on a round surface: where they are, in rendered pictures of any size."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from rendering import pair
from synthetic_world import DOWN, World, level_pose

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import distances_from_axis
from pipeline_tracker.face import on_face, without_sag
from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.settings_io import settings_from_values
from pipeline_tracker.surface import SurfacePoints, triangulate
from pipeline_tracker.vectorization.patch_alignment import make_patch, patch_variance
from pipeline_tracker.vectorization.vectorizer import Vectorizer
from pipeline_tracker.vectorization.working_size import WORKING_WIDTH, working_factor

Array = NDArray[np.float64]


def rig_of(width: int, height: int, focal: float) -> StereoRig:
    middle = (width - 1) / 2.0, (height - 1) / 2.0
    left = Camera(focal, focal, *middle, width, height)
    return StereoRig(left, Camera(focal, focal, *middle, width, height, offset=0.2))


def face_of(rig: StereoRig, heading: float, stops: int) -> tuple[SurfacePoints, Axis]:
    """The points on a pipe's face, as they are found in its pictures, and its axis."""
    world = World.with_pipe(height=2.0, heading=heading)
    assert world.pipe is not None
    vectorizer = Vectorizer(settings_from_values({"pipe.diameter": 0.6}))
    to_optical = DOWN.inverse()
    axis = Axis.straight(
        to_optical.apply(world.pipe.point), to_optical.rotate(world.pipe.direction)
    )
    axis = axis.moved(float(-axis.point @ axis.direction))
    # On along the pipe: it looks the same, but for its texture.
    ways = 0.8 * np.arange(stops)[:, None] * world.pipe.direction
    poses = [level_pose(*way) for way in ways]
    matches = [
        vectorizer.process(0, rig, *pair(world, pose, DOWN, rig, seed)).matches
        for seed, pose in enumerate(poses)
    ]
    surface = triangulate(np.concatenate(matches), rig)
    return surface.subset(on_face(surface, rig.left, axis, 0.3)), axis


def off(face: SurfacePoints, axis: Axis) -> float:
    """How far the points are from the pipe's surface, outward positive, the median, m."""
    return float(np.median(distances_from_axis(face.points, axis)[1] - 0.3))


@pytest.mark.parametrize(
    ("width", "height", "focal"),
    [(480, 320, 280.0), (480, 320, 400.0), (321, 487, 280.0), (1701, 500, 560.0)],
)
@pytest.mark.parametrize("heading", [0.0, 0.5])
def test_points_are_as_far_inside_as_patches_are_wide(
    width: int, height: int, focal: float, heading: float
) -> None:
    rig = rig_of(width, height, focal)
    face, axis = face_of(rig, heading, 4)
    assert len(face.points) > 100
    inside = -off(face, axis)
    pixel = float(np.median(face.points[:, 2])) * working_factor(width) / focal
    least = 0.5 * patch_variance() * pixel**2 / 0.3
    # More beside the middle, where the surface turns away.
    assert least < inside < 2.5 * least
    assert abs(off(without_sag(face, rig.left, axis, 0.3), axis)) < 0.35 * inside


def test_the_reach_of_a_patch_is_that_of_its_weights() -> None:
    patch = make_patch()
    weights = patch.weight.astype(np.float64).reshape(11, 20)
    assert (weights[:, 19] == 0.0).all()
    assert np.allclose(weights[:, :19], weights[::-1, 18::-1])
    for places in (patch.across, patch.down):
        squares = np.sum(weights.ravel() * places**2.0) / weights.sum()
        # The same both ways: pipes run down the picture, and across it.
        assert patch_variance() == pytest.approx(squares, rel=0.02)
    assert math.sqrt(patch_variance()) == pytest.approx(4.5, abs=0.1)


def test_no_points_stay_none() -> None:
    rig = rig_of(480, 320, 300.0)
    none = triangulate(np.zeros((0, 4), np.float32), rig)
    axis = Axis.straight(np.array([0.0, 0.0, 2.0]), np.array([0.0, 1.0, 0.0]))
    assert len(without_sag(none, rig.left, axis, 0.3).points) == 0


@pytest.mark.parametrize(
    ("width", "border"), [(640, 10), (1200, 10), (WORKING_WIDTH, 10), (1601, 20), (4008, 30)]
)
def test_the_face_ends_where_patches_reach_over_the_contour(width: int, border: int) -> None:
    # A pipe so far that its contours, not the share of its face, set the limit.
    focal, far = 0.8 * width, 8.0
    rig = rig_of(width, width // 2, focal)
    axis = Axis.straight(np.array([0.0, 0.0, far]), np.array([0.0, 1.0, 0.0]))
    xs = np.linspace(-0.3, 0.3, 4001) * focal / far + rig.left.cx
    surface = SurfacePoints(
        np.zeros((4001, 3)),
        rig.left.rays(np.stack((xs, np.full(4001, rig.left.cy)), axis=1)),
        np.zeros(4001),
        np.zeros((4001, 2)),
        np.zeros((4001, 2)),
    )
    surface.rays[:] /= np.linalg.norm(surface.rays, axis=1)[:, None]
    seen = xs[on_face(surface, rig.left, axis, 0.3)]
    contour = focal * 0.3 / math.sqrt(far**2 - 0.09)
    limit = rig.left.cx + contour - border
    assert seen.max() == pytest.approx(min(limit, rig.left.cx + 0.9 * contour), abs=0.2)
