"""The robust fit of the axis: exact data, outliers, bends, prior, and a covariance to trust."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from silhouettes import Cylinder, outlines

from pipeline_tracker.axis_fit import (
    BEND_SIGMA,
    Axis,
    AxisFit,
    Evidence,
    Prior,
    across,
    fit_axis,
)
from pipeline_tracker.axis_solver import _normal_equations, _residuals
from pipeline_tracker.geometry.camera import Camera

Array = NDArray[np.float64]

LEFT = Camera(930.0, 930.0, 599.5, 399.5, 1200, 800)
RIGHT = Camera(930.0, 930.0, 599.5, 399.5, 1200, 800, offset=0.2)
# The camera looks down, a little forward.
UP = np.array([0.0, -0.2, -1.0]) / math.hypot(0.2, 1.0)
POINT_SIGMA, RAY_SIGMA = 0.005, 0.0006


def pipe(degrees: float = 80.0, depth: float = 2.0, tilt: float = 0.1) -> Cylinder:
    return Cylinder.seen(
        np.array([640.0, 380.0]), depth, math.radians(degrees), tilt, 0.3, camera=LEFT
    )


def truth(cylinder: Cylinder) -> Axis:
    return Axis.straight(cylinder.point, cylinder.direction)


def frame_of(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors across a direction: towards the camera at the origin's side, and aside."""
    near = np.array([0.0, 0.0, -1.0]) + direction * direction[2]
    near /= np.linalg.norm(near)
    return near, np.cross(direction, near)


def face(cylinder: Cylinder, count: int, random: np.random.Generator) -> Array:
    near, aside = frame_of(cylinder.direction)
    turn = random.uniform(-1.1, 1.1, (count, 1))
    along = random.uniform(-1.0, 1.0, (count, 1)) * cylinder.direction
    ring = np.cos(turn) * near + np.sin(turn) * aside
    return np.asarray(cylinder.point + along + cylinder.radius * ring)


def contours(
    cylinder: Cylinder, cameras: tuple[Camera, ...] = (LEFT, RIGHT), count: int = 12
) -> tuple[Array, Array, Array]:
    """Unit rays to both outlines in each image, their origins and sides."""
    rays, origins, sides = [], [], []
    for camera in cameras:
        origin = np.array([camera.offset, 0.0, 0.0])
        for side, ends in zip((-1.0, 1.0), outlines(cylinder, camera), strict=True):
            # The piece within 1 m of the middle.
            middle = ends[0] + cylinder.direction * (
                (cylinder.point - ends[0]) @ cylinder.direction
            )
            places = middle + np.linspace(-1.0, 1.0, count)[:, None] * cylinder.direction
            away = places - origin
            rays.append(away / np.linalg.norm(away, axis=1)[:, None])
            origins.append(np.tile(origin, (count, 1)))
            sides.append(np.full(count, side))
    return np.concatenate(rays), np.concatenate(origins), np.concatenate(sides)


def evidence(
    points: Array | None = None,
    seen: tuple[Array, Array, Array] | None = None,
    point_sigma: float = POINT_SIGMA,
) -> Evidence:
    none = np.zeros((0, 3))
    points = none if points is None else points
    rays, origins, sides = (none, none, np.zeros(0)) if seen is None else seen
    return Evidence(
        points=points,
        point_sigmas=np.full(len(points), point_sigma),
        rays=rays,
        origins=origins,
        sides=sides,
        ray_sigmas=np.full(len(rays), RAY_SIGMA),
        ray_weights=np.ones(len(rays)),
    )


def moved_off(axis: Axis, offset: Array, turn: Array) -> Axis:
    return Axis.straight(axis.point + offset, axis.direction + turn)


def gap(axis: Axis, cylinder: Cylinder) -> float:
    """Largest distance of the axis from the true one within 1 m of its middle, m."""
    return max(float(cylinder.distance(axis.at(t))) for t in (-1.0, -0.5, 0.0, 0.5, 1.0))


def parameters(fit: AxisFit, true: Axis) -> Array:
    """Left, up, heading, pitch of a fit less those of the truth, (4,)."""
    t = float((fit.axis.point - true.point) @ true.direction)
    off = fit.axis.point - true.at(t)
    turn = fit.axis.direction - true.tangent(t)
    return np.array([off @ fit.left, off @ fit.up, turn @ fit.left, turn @ fit.up])


# Exact data.


@given(
    st.floats(0.0, 360.0),
    st.floats(1.2, 4.0),
    st.floats(-0.4, 0.4),
    st.lists(st.floats(-0.05, 0.05), min_size=6, max_size=6),
)
@settings(max_examples=20)
def test_exact_points_and_rays_give_the_axis(
    degrees: float, depth: float, tilt: float, off: list[float]
) -> None:
    cylinder = pipe(degrees, depth, tilt)
    points = face(cylinder, 60, np.random.default_rng(1))
    start = moved_off(truth(cylinder), np.array(off[:3]), 0.6 * np.array(off[3:]))
    fit = fit_axis(start, 0.3, evidence(points, contours(cylinder)), UP)
    assert gap(fit.axis, cylinder) < 1e-6
    assert fit.axis.direction @ cylinder.direction > 1.0 - 1e-12


@pytest.mark.parametrize("degrees", [0, 45, 80, 90, 135, 180, 260, 359])
def test_points_alone_or_contours_alone_are_enough(degrees: int) -> None:
    cylinder = pipe(degrees)
    start = moved_off(truth(cylinder), np.array([0.03, -0.02, 0.04]), np.full(3, 0.01))
    points = evidence(face(cylinder, 60, np.random.default_rng(1)))
    assert gap(fit_axis(start, 0.3, points, UP).axis, cylinder) < 1e-6
    both = evidence(seen=contours(cylinder))
    assert gap(fit_axis(start, 0.3, both, UP).axis, cylinder) < 1e-6
    one_image = evidence(seen=contours(cylinder, (LEFT,)))
    assert gap(fit_axis(start, 0.3, one_image, UP).axis, cylinder) < 1e-5


def test_the_origin_stays_abreast_of_the_start() -> None:
    cylinder = pipe()
    start = Axis.straight(cylinder.point + 0.4 * cylinder.direction, cylinder.direction)
    fit = fit_axis(start, 0.3, evidence(face(cylinder, 60, np.random.default_rng(1))), UP)
    assert (fit.axis.point - cylinder.point) @ cylinder.direction == pytest.approx(0.4, abs=1e-6)


# Outliers.


@pytest.mark.parametrize("seed", range(6))
def test_points_of_the_bed_do_not_move_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    cylinder = pipe(60.0 * seed)
    points = face(cylinder, 120, random) + random.normal(0.0, 0.004, (120, 3))
    near, aside = frame_of(cylinder.direction)
    offsets = random.choice([-1.0, 1.0], (50, 1)) * random.uniform(0.31, 0.8, (50, 1))
    along = random.uniform(-1.0, 1.0, (50, 1)) * cylinder.direction
    bed = cylinder.point + along + offsets * aside - 0.3 * near
    start = moved_off(truth(cylinder), np.array([0.03, -0.02, 0.04]), np.full(3, 0.01))
    seen = contours(cylinder)
    clean = fit_axis(start, 0.3, evidence(points, seen), UP)
    fit = fit_axis(start, 0.3, evidence(np.concatenate((points, bed)), seen), UP)
    assert gap(fit.axis, cylinder) < 0.002
    assert np.linalg.norm(fit.axis.point - clean.axis.point) < 0.001
    # And they are told from the pipe: 10 cm off the surface is 20 standard deviations.
    far = np.abs(np.hypot(offsets[:, 0], 0.3) - 0.3) > 0.03
    assert fit.point_weights[120:][far].max() < 0.01
    assert np.median(fit.point_weights[:120]) > 0.7


def test_a_wrong_line_beside_the_contour_does_not_move_it() -> None:
    cylinder = pipe()
    rays, origins, sides = contours(cylinder, count=20)
    wrong = rays.copy()
    wrong[::5] += [0.02, 0.01, 0.0]  # 19 px off
    wrong /= np.linalg.norm(wrong, axis=1)[:, None]
    points = face(cylinder, 60, np.random.default_rng(1))
    fit = fit_axis(truth(cylinder), 0.3, evidence(points, (wrong, origins, sides)), UP)
    assert gap(fit.axis, cylinder) < 1e-4
    assert fit.ray_weights[::5].max() < 0.05


# Bends.


def bent_face(axis: Axis, radius: float, count: int, random: np.random.Generator) -> Array:
    """Points of the face of a pipe round an arc that has the bend of the axis, exactly."""
    curvature = float(np.linalg.norm(axis.bend))
    inward = axis.bend / curvature
    s = random.uniform(-1.5, 1.5, (count, 1))
    middle = (
        axis.point
        + np.sin(curvature * s) / curvature * axis.direction
        + (1.0 - np.cos(curvature * s)) / curvature * inward
    )
    tangent = np.cos(curvature * s) * axis.direction + np.sin(curvature * s) * inward
    near = np.array([0.0, 0.0, -1.0]) - tangent * (tangent @ [0.0, 0.0, -1.0])[:, None]
    near /= np.linalg.norm(near, axis=1)[:, None]
    turn = random.uniform(-1.1, 1.1, (count, 1))
    return np.asarray(
        middle + radius * (np.cos(turn) * near + np.sin(turn) * np.cross(tangent, near))
    )


@pytest.mark.parametrize("degrees", [10.0, 80.0, 170.0, 280.0])
@pytest.mark.parametrize("bend_left", [1.0 / 30.0, -1.0 / 30.0, 1.0 / 100.0])
def test_bends_are_recovered(degrees: float, bend_left: float) -> None:
    straight = truth(pipe(degrees))
    left, up = across(straight.direction, UP)
    axis = Axis(straight.point, straight.direction, bend_left * left + 0.005 * up)
    points = bent_face(axis, 0.3, 300, np.random.default_rng(2))
    start = moved_off(straight, np.array([0.02, -0.02, 0.03]), np.full(3, 0.005))
    fit = fit_axis(start, 0.3, evidence(points), UP)
    # 300 points of 5 mm against a prior of 0.03 1/m for the bend pull it a little to 0.
    assert np.linalg.norm(fit.axis.bend - axis.bend) < 0.03 * abs(bend_left) + 1e-4
    curve = np.array([axis.at(t) for t in np.linspace(-2.0, 2.0, 4001)])
    for t in (-1.5, -0.7, 0.0, 0.7, 1.5):
        assert np.linalg.norm(curve - fit.axis.at(t), axis=1).min() < 0.001


def test_a_bend_against_its_prior_is_pulled_to_straight() -> None:
    # Two points say nothing of a bend: the prior's word counts.
    cylinder = pipe()
    points = face(cylinder, 40, np.random.default_rng(1))
    fit = fit_axis(truth(cylinder), 0.3, evidence(points[:6]), UP)
    assert np.linalg.norm(fit.axis.bend) < 1e-9
    assert math.sqrt(fit.covariance[4, 4]) <= BEND_SIGMA + 1e-12


# Covariance.


@pytest.mark.parametrize(
    ("point_noise", "with_contours"), [(1.0, True), (1.0, False), (1.8, False), (1.0, None)]
)
def test_the_covariance_is_calibrated(point_noise: float, with_contours: bool | None) -> None:
    """Monte Carlo: squared errors normalised by the covariance have the mean of chi squared.

    With 400 runs the mean of four degrees of freedom has a standard deviation of 0.14; that each
    run measures its own noise by 80 points makes it a tenth larger than 4.
    """
    random = np.random.default_rng(11)
    cylinder = pipe(65.0)
    true = truth(cylinder)
    runs = 400
    squares = np.empty(runs)
    errors = np.empty((runs, 4))
    rays, origins, sides = contours(cylinder)
    for run in range(runs):
        points = None
        if with_contours is not None:
            points = face(cylinder, 80, random)
            near = points - cylinder.point
            near -= np.outer(near @ cylinder.direction, cylinder.direction)
            near /= np.linalg.norm(near, axis=1)[:, None]
            points = points + near * random.normal(0.0, point_noise * POINT_SIGMA, (80, 1))
        seen = None
        if with_contours is not False:
            # Noise across the rays, as an angle.
            shaken = rays + random.normal(0.0, RAY_SIGMA, rays.shape)
            seen = (shaken / np.linalg.norm(shaken, axis=1)[:, None], origins, sides)
        fit = fit_axis(true, 0.3, evidence(points, seen), UP)
        errors[run] = parameters(fit, true)
        squares[run] = errors[run] @ np.linalg.solve(fit.covariance[:4, :4], errors[run])
    assert 3.4 < squares.mean() < 5.0
    # Not biased either.
    bound = 4.0 * errors.std(axis=0) / math.sqrt(runs)
    assert (np.abs(errors.mean(axis=0)) < bound + 1e-4).all()


def test_more_data_makes_it_surer() -> None:
    cylinder = pipe()
    few, many = (
        fit_axis(
            truth(cylinder), 0.3, evidence(face(cylinder, count, np.random.default_rng(1))), UP
        )
        for count in (50, 200)
    )
    ratio = np.sqrt(np.diag(few.covariance)[:2] / np.diag(many.covariance)[:2])
    # Four times the points, half the standard deviation.
    assert (np.abs(ratio - 2.0) < 0.5).all()


# Prior.


def test_the_prior_pulls_as_the_weighted_mean_says() -> None:
    cylinder = pipe()
    expected = moved_off(truth(cylinder), np.array([0.002, 0.001, -0.002]), np.full(3, 0.001))
    data = evidence(face(cylinder, 20, np.random.default_rng(1)))
    # Six steps of one width, wide: nothing is weighted down.
    wide = (1e3,) * 6
    alone = fit_axis(expected, 0.3, data, UP, widths=wide)
    sigmas = np.array([0.001, 0.002, 0.001, 0.002, BEND_SIGMA, BEND_SIGMA])
    pulled = fit_axis(expected, 0.3, data, UP, Prior(expected, sigmas), wide)

    # Gaussian product of what the data alone say and of the prior, at the prior's own axis.
    loose = np.diag([1e-2, 1e-2, 1.0 / 9.0, 1.0 / 9.0, BEND_SIGMA**-2.0, BEND_SIGMA**-2.0])
    information = np.linalg.inv(alone.covariance) - loose
    prior = np.diag(1.0 / np.square(sigmas))
    off = alone.axis.point - expected.point
    turn = alone.axis.direction - expected.direction
    left, up = alone.left, alone.up
    bend = alone.axis.bend
    says = np.array([off @ left, off @ up, turn @ left, turn @ up, bend @ left, bend @ up])
    mean = np.linalg.solve(information + prior, information @ says)
    off = pulled.axis.point - expected.point
    turn = pulled.axis.direction - expected.direction
    got = np.array([off @ left, off @ up, turn @ left, turn @ up])
    assert np.abs(says[:4]).max() > 1e-3
    assert np.allclose(got, mean[:4], atol=3e-5)
    covariance = np.linalg.inv(information + prior)
    deviations = np.sqrt(np.diag(covariance))
    # Both are taken where their own fit ended, 1 mm from each other.
    error = (pulled.covariance - covariance) / np.outer(deviations, deviations)
    assert np.abs(error).max() < 0.02


def test_one_contour_leaves_the_rest_to_the_prior() -> None:
    # One contour of one image gives two conditions: the axis is one radius from its plane.
    cylinder = pipe(90.0, tilt=0.0)
    rays, origins, sides = contours(cylinder, (LEFT,))
    left_one = sides < 0
    seen = rays[left_one], origins[left_one], sides[left_one]
    expected = moved_off(truth(cylinder), np.array([0.02, 0.0, 0.02]), np.zeros(3))
    sigmas = np.array([0.05, 0.05, 0.02, 0.02, BEND_SIGMA, BEND_SIGMA])
    fit = fit_axis(expected, 0.3, evidence(seen=seen), UP, Prior(expected, sigmas))
    normal = np.cross(rays[0], rays[left_one][-1])
    normal /= np.linalg.norm(normal)
    for t in (-0.5, 0.5):
        assert abs(fit.axis.at(t) @ normal) == pytest.approx(0.3, abs=1e-3)
    # Across the plane it went to the contour, along the plane it stayed.
    moved = fit.axis.point - expected.point
    assert np.linalg.norm(moved - normal * (moved @ normal)) < 0.1 * np.linalg.norm(moved)
    # It is sure of the one and as unsure of the other as before.
    variances = np.linalg.eigvalsh(fit.covariance[:2, :2])
    assert math.sqrt(variances[0]) < 0.002
    assert 0.03 < math.sqrt(variances[1]) < 0.051


def test_a_prior_whose_origin_is_elsewhere_along_the_axis_says_the_same() -> None:
    cylinder = pipe()
    true = truth(cylinder)
    data = evidence(face(cylinder, 30, np.random.default_rng(1)))
    sigmas = np.array([0.01, 0.01, 0.01, 0.01, BEND_SIGMA, BEND_SIGMA])
    here = fit_axis(true, 0.3, data, UP, Prior(true, sigmas))
    there = fit_axis(true, 0.3, data, UP, Prior(true.moved(0.8), sigmas))
    assert np.allclose(here.axis.point, there.axis.point, atol=1e-9)
    assert np.allclose(here.covariance, there.covariance)


def test_without_evidence_the_prior_is_the_answer() -> None:
    cylinder = pipe()
    expected = truth(cylinder)
    sigmas = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    start = moved_off(expected, np.array([0.0, 0.01, 0.02]), np.full(3, 0.01))
    fit = fit_axis(start, 0.3, evidence(), UP, Prior(expected, sigmas))
    assert gap(fit.axis, cylinder) < 3e-4
    assert np.allclose(np.sqrt(np.diag(fit.covariance)), sigmas)


# Turning things round.


def test_the_direction_of_travel_changes_signs_alone() -> None:
    cylinder = pipe()
    random = np.random.default_rng(3)
    points = face(cylinder, 60, random) + random.normal(0.0, 0.004, (60, 3))
    rays, origins, sides = contours(cylinder)
    start = moved_off(truth(cylinder), np.array([0.02, 0.0, 0.02]), np.zeros(3))
    there = fit_axis(start, 0.3, evidence(points, (rays, origins, sides)), UP)
    back = fit_axis(start.reversed(), 0.3, evidence(points, (rays, origins, -sides)), UP)
    assert np.allclose(back.axis.point, there.axis.point, atol=1e-9)
    assert np.allclose(back.axis.direction, -there.axis.direction, atol=1e-9)
    # Derivatives are differences of 1e-6.
    assert np.allclose(back.axis.bend, there.axis.bend, atol=1e-5)
    # Left and pitch turn round, up and heading stay.
    signs = np.array([-1.0, 1.0, 1.0, -1.0])
    turned = there.covariance[:4, :4] * np.outer(signs, signs)
    assert np.allclose(back.covariance[:4, :4], turned, rtol=1e-3, atol=1e-10)


# The axis.


def test_the_frame_across_is_left_and_up() -> None:
    forward, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    assert np.allclose(across(forward, up), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    climbing = np.array([0.8, 0.0, 0.6])
    left, normal = across(climbing, up)
    assert np.allclose(left, [0.0, 1.0, 0.0])
    assert np.allclose(normal, [-0.6, 0.0, 0.8])
    for vertical in (up, -up):
        left, normal = across(vertical, up)
        assert np.allclose(np.stack((vertical, left, normal)) @ vertical, [1.0, 0.0, 0.0])
        assert math.isclose(np.linalg.norm(left), 1.0)
        assert math.isclose(np.linalg.norm(normal), 1.0)


def test_an_axis_moved_along_itself_is_the_same_axis() -> None:
    axis = Axis(np.array([0.1, 0.2, 2.0]), np.array([0.0, 1.0, 0.0]), np.array([0.02, 0.0, 0.01]))
    curve = np.array([axis.at(t) for t in np.linspace(-3.0, 3.0, 60_001)])
    moved = axis.moved(0.9)
    assert np.allclose(moved.point, axis.at(0.9))
    assert math.isclose(np.linalg.norm(moved.direction), 1.0)
    assert abs(moved.bend @ moved.direction) < 1e-12
    for t in (-1.0, 0.0, 1.0):
        # A parabola is not quite one again when seen from another of its points.
        assert np.linalg.norm(curve - moved.at(t), axis=1).min() < 1e-4
    turned = axis.reversed()
    assert np.allclose(turned.at(-0.7), axis.at(0.7))
    assert np.allclose(turned.tangent(-0.7), -axis.tangent(0.7))


# Compiled kernels.


def jacobian_of(shifts: Array) -> Array:
    """(6, N): a parameter shifts a place of the axis to the left or up, by 1, t or t² / 2."""
    left, up, t = shifts
    return np.stack((left, up, t * left, t * up, 0.5 * t * t * left, 0.5 * t * t * up))


def test_residuals_agree_with_a_slow_reference() -> None:
    random = np.random.default_rng(8)
    cylinder = pipe()
    start = truth(cylinder)
    left, up = across(start.direction, UP)
    frame = np.stack((start.point, start.direction, left, up, 0.01 * left - 0.02 * up))
    values = np.array([0.02, -0.03, 0.01, -0.015, 0.004, 0.006])
    points = face(cylinder, 15, random) + random.normal(0.0, 0.05, (15, 3))
    rays, origins, sides = contours(cylinder, count=5)
    rays = rays + random.normal(0.0, 0.02, rays.shape)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    sigmas, ray_sigmas = random.uniform(0.004, 0.01, 15), random.uniform(5e-4, 1e-3, len(rays))
    out, shifts = np.empty(15 + len(rays)), np.empty((3, 15 + len(rays)))
    evidence = (frame, 0.3, points.T.copy(), sigmas, rays, origins, sides, ray_sigmas)
    _residuals(values, *evidence, out, shifts)
    jacobian = jacobian_of(shifts)
    # Derivatives by differences: of rays within what a change of their depth does.
    shifted, unused = np.empty_like(out), np.empty_like(shifts)
    for a in range(6):
        moved = values.copy()
        moved[a] += 1e-6
        _residuals(moved, *evidence, shifted, unused)
        by_differences = (shifted - out) / 1e-6
        assert jacobian[a, :15] == pytest.approx(by_differences[:15], rel=1e-2, abs=0.3)
        scale = np.abs(by_differences[15:]).max()
        assert jacobian[a, 15:] == pytest.approx(by_differences[15:], abs=0.05 * scale)

    t = np.linspace(-3.0, 3.0, 60_001)[:, None]
    begin = start.point + values[0] * left + values[1] * up
    direction = start.direction + values[2] * left + values[3] * up
    bend = (0.01 + values[4]) * left + (-0.02 + values[5]) * up
    curve = begin + t * direction + 0.5 * t * t * bend
    for k, point in enumerate(points):
        nearest = np.linalg.norm(curve - point, axis=1).min()
        assert out[k] == pytest.approx((nearest - 0.3) / sigmas[k], abs=0.01)
    for k, (ray, origin) in enumerate(zip(rays, origins, strict=True)):
        away = curve - origin
        depth = away @ ray
        off = away - depth[:, None] * ray
        best = int(np.argmin(np.linalg.norm(off, axis=1)))
        tangent = direction + t[best] * bend
        # To the right of travel, as seen by the camera: along tangent x (towards the camera).
        rightward = np.cross(tangent, -away[best])
        distance = np.linalg.norm(off[best]) * np.sign(-off[best] @ rightward)
        expected = (sides[k] * distance - 0.3) / (depth[best] * ray_sigmas[k])
        assert out[15 + k] == pytest.approx(expected, abs=0.02)


def test_normal_equations_agree_with_numpy() -> None:
    random = np.random.default_rng(9)
    shifts, residuals = random.normal(size=(3, 40)), random.normal(size=40)
    jacobian = jacobian_of(shifts)
    weights = random.uniform(0.0, 1.0, 40)
    weights[::4] = 0.0
    hessian, gradient = np.eye(6), np.ones(6)
    _normal_equations(shifts, residuals, weights, hessian, gradient)
    assert np.allclose(hessian, np.eye(6) + jacobian @ np.diag(weights) @ jacobian.T)
    assert np.allclose(gradient, 1.0 + jacobian @ (weights * residuals))


def test_the_steps_agree_with_numpy() -> None:
    random = np.random.default_rng(10)
    cylinder = pipe()
    start = truth(cylinder)
    points = face(cylinder, 60, random) + random.normal(0.0, 0.004, (60, 3))
    points[:5] += [0.0, 0.0, 0.2]
    data = evidence(points, contours(cylinder))
    prior = Prior(start, np.array([0.02, 0.03, 0.01, 0.02, BEND_SIGMA, BEND_SIGMA]))
    widths = (12.0, 6.0, 4.0)
    fit = fit_axis(start, 0.3, data, UP, prior, widths)

    left, up = across(start.direction, UP)
    frame = np.stack((start.point, start.direction, left, up, start.bend))
    size = len(points) + len(data.rays)
    base = np.concatenate((np.full(len(points), data.point_weight), data.ray_weights))
    information, values, noise = np.diag(1.0 / np.square(prior.sigmas)), np.zeros(6), 1.0
    hessian, weights = information, base
    for width in widths:
        out, shifts = np.empty(size), np.empty((3, size))
        rows = (data.points.T.copy(), data.point_sigmas, data.rays, data.origins, data.sides)
        _residuals(values, frame, 0.3, *rows, data.ray_sigmas, out, shifts)
        jacobian = jacobian_of(shifts)
        scale = np.where(np.arange(size) < len(points), noise, 1.0)
        weights = np.square(np.clip(1.0 - np.square(out / scale / width), 0.0, None))
        scaled = base * weights / np.square(scale)
        hessian = information + jacobian @ np.diag(scaled) @ jacobian.T
        values = values - np.linalg.solve(hessian, information @ values + jacobian @ (scaled * out))
        inside = out[: len(points)][weights[: len(points)] > 0.0]
        noise = float(np.clip(1.4826 * np.median(np.abs(inside)), 0.6, 2.5)) if width < 7 else 1.0
    moved = start.point + values[0] * left + values[1] * up
    assert np.allclose(fit.axis.point, moved, atol=1e-9)
    assert np.allclose(fit.axis.bend @ fit.left, values[4], atol=1e-6)
    assert np.allclose(fit.covariance, np.linalg.inv(hessian), rtol=1e-6)
    assert np.allclose(np.concatenate((fit.point_weights, fit.ray_weights)), weights, atol=1e-9)
    assert fit.noise == pytest.approx(noise)
