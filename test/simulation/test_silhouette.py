"""The drawn silhouette against the true one, computed by an independent dense search."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.truth import HIDDEN, VISIBLE, frame_contours, stretch_in_view

Array = NDArray[np.float64]

# A pipe that hangs above the bed, so that nothing hides its contours, and that bends well.
CLEAR = (
    "bed.burial=-0.6",
    "bed.drifts=[]",
    "bed.stones=0",
    "pipe.bend_radius=12",
    "pipe.bend_length=8",
    "pipe.sag_radius=30",
    "path.lateral_start=0.2",
    "path.heading_sway_deg=12",
    "camera.width=320",
    "camera.height=208",
)
ROWS = np.arange(3, 208, 12)


def ray_gap(axis_points: Array, camera: Camera, pose: Pose, pixels: Array) -> Array:
    """Return the least distance of the axis from the ray through each pixel (N, 2), m."""
    rays = pose.rotate(camera.rays(pixels))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    offset = axis_points - pose.translation
    along = offset @ rays.T
    square = np.sum(offset**2, axis=1)[:, None] - along**2
    gap: Array = np.sqrt(np.where(along > 0, square, np.inf).min(axis=0))
    return gap


def dense_edges(sea: Sea, camera: Camera, pose: Pose, rows: Array) -> Array:
    """Find where rays begin and cease to meet the pipe in each row: (N, 2), px; NaN: not in view.

    A ray meets the pipe where it passes the axis, here points a millimetre apart, within the
    radius. No tangent, no mesh, no contour formula.
    """
    points = sea.scene.axis.points(np.arange(-4.0, 9.0, 1e-3))
    columns = np.arange(-0.5, camera.width, 1.0)
    edges = np.full((len(rows), 2), np.nan)
    for n, row in enumerate(rows):
        pixels = np.stack([columns, np.full(len(columns), row)], axis=1)
        inside = np.flatnonzero(ray_gap(points, camera, pose, pixels) < sea.scene.axis.radius)
        if not len(inside) or inside[0] == 0 or inside[-1] == len(columns) - 1:
            continue
        for k, (out, within) in enumerate(
            ((inside[0] - 1, inside[0]), (inside[-1] + 1, inside[-1]))
        ):
            low, high = columns[out], columns[within]
            for _ in range(20):
                middle = (low + high) / 2
                gap = ray_gap(points, camera, pose, np.array([[middle, row]]))[0]
                low, high = (low, middle) if gap < sea.scene.axis.radius else (middle, high)
            edges[n, k] = (low + high) / 2
    return edges


@pytest.fixture(scope="module")
def clear_sea(small: Callable[..., Scenario]) -> Sea:
    return build_sea(small(*CLEAR, seed=5))


@pytest.fixture(scope="module", params=[(0, 0.0), (1, 0.0), (0, 1.0)])
def view(clear_sea: Sea, request: pytest.FixtureRequest) -> tuple[Sea, int, Pose, Array]:
    index, time = request.param
    base = clear_sea.motion.pose(time)
    pose = base @ clear_sea.mountings()[index]
    camera = clear_sea.scenario.camera.rig().cameras[index]
    return clear_sea, index, base, dense_edges(clear_sea, camera, pose, ROWS)


def test_the_drawn_silhouette_is_the_true_one(view: tuple[Sea, int, Pose, Array]) -> None:
    sea, index, base, edges = view
    coverage = sea.renderer.render(base, index).coverage.astype(np.float64)
    known = np.flatnonzero(np.isfinite(edges).all(axis=1))
    assert len(known) > 10
    for n in known:
        left, right = edges[n]
        line = coverage[ROWS[n]]
        middle = int((left + right) / 2)
        # From a pixel within, the covered length to each side ends at the silhouette.
        drawn_left = middle + 0.5 - line[: middle + 1].sum()
        drawn_right = middle + 0.5 + line[middle + 1 :].sum()
        assert drawn_left == pytest.approx(left, abs=0.1)
        assert drawn_right == pytest.approx(right, abs=0.1)


def test_the_true_contours_are_where_rays_graze(view: tuple[Sea, int, Pose, Array]) -> None:
    sea, index, base, edges = view
    cameras = sea.scenario.camera.rig().cameras
    poses = tuple(base @ mounting for mounting in sea.mountings())
    s = stretch_in_view(sea.scene.axis, cameras, poses)
    found = frame_contours(sea.scene.axis, sea.scene.caster, cameras[index], poses[index], s)
    assert (found.flags == VISIBLE).any(axis=1).all()
    assert not (found.flags == HIDDEN).any()
    for side in range(2):
        x, y = found.pixels[side].T
        order = np.argsort(y)
        drawn = np.interp(ROWS, y[order], x[order])
        known = np.isfinite(edges[:, side])
        # Between points 5 cm apart the interpolation is straight.
        assert np.abs(drawn - edges[:, side])[known].max() < 0.05


def test_the_image_mixes_pipe_and_bed_by_the_covered_share(small: Callable[..., Scenario]) -> None:
    # Even surfaces in light from everywhere, no haze: what is between them is the share alone.
    flat = (
        "pipe.texture=0",
        "pipe.growth=0",
        "pipe.sediment=0",
        "pipe.colour=[0.9,0.9,0.9]",
        "bed.texture=0",
        "bed.colour=[0.05,0.05,0.05]",
        "water.attenuation=[0,0,0]",
        "water.backscatter=[0,0,0]",
        "water.ambient=100",
    )
    sea = build_sea(small(*CLEAR, *flat, seed=5))
    rendering = sea.renderer.render(sea.motion.pose(0.0), 0)
    light, coverage = rendering.light[..., 1], rendering.coverage
    mixed = np.argwhere((coverage > 0.05) & (coverage < 0.95))
    assert len(mixed) > 100
    differences = []
    for y, x in mixed:
        outward = 1 if coverage[y, x - 1] > coverage[y, x + 1] else -1
        near, far, bed = (light[y, x + step * outward] for step in (-1, -2, 2))
        if coverage[y, x - outward] == 1.0:
            # The pipe's flank darkens towards its border.
            pipe = near + (near - far)
            differences.append((light[y, x] - bed) / (pipe - bed) - coverage[y, x])
    assert len(differences) > 100
    assert np.abs(differences).max() < 0.1
    assert abs(np.mean(differences)) < 0.03
