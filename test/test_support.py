"""How well pictures bear an axis: contours, face and plane; what is refused, and why."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from silhouettes import Cylinder, outline_lines
from synthetic_world import DOWN, EXACT, LEFT, MONO, RIG, Bed, Diver, Look, Pipe, World, level_pose

from pipeline_tracker.acceptance import refusal, score, support_share
from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.face import ROUGHNESS, on_face
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.plane import plane_cost
from pipeline_tracker.support import (
    ContourSupport,
    Support,
    _nearest_line,
    contour_pieces,
    contour_support,
    depth_ratio,
    judge,
    seen_lines,
)
from pipeline_tracker.surface import triangulate
from pipeline_tracker.types import Contours
from pipeline_tracker.voting import line_support

Array = NDArray[np.float64]

ALL = (
    Contours.LEFT_IMAGE_LEFT,
    Contours.LEFT_IMAGE_RIGHT,
    Contours.RIGHT_IMAGE_LEFT,
    Contours.RIGHT_IMAGE_RIGHT,
)
PERFECT = replace(EXACT, seen=(1.0, 1.0, 1.0, 1.0))


def axis_of(pipe: Pipe) -> Axis:
    """The pipe's axis in the left optical frame over odom's origin, abreast of the camera."""
    to_optical = DOWN.inverse()
    axis = Axis.straight(to_optical.apply(pipe.point), to_optical.rotate(pipe.direction))
    bent = Axis(axis.point, axis.direction, pipe.curvature * to_optical.rotate(pipe.left))
    return bent.moved(float(-bent.point @ bent.direction))


def scene(look: Look = PERFECT, rig: StereoRig = RIG, **pipe: float) -> tuple[Diver, Axis]:
    world = World.with_pipe(**pipe)
    assert world.pipe is not None
    return Diver(world, rig, look=look), axis_of(world.pipe)


def contours_of(diver: Diver, axis: Axis) -> dict[Contours, ContourSupport]:
    frame = diver.frame(level_pose())
    return {found.bit: found for found in contour_support(frame, axis, 0.3)}


def judged(diver: Diver, axis: Axis, seed: int = 0) -> Support:
    frame = diver.frame(level_pose(), seed=seed)
    return judge(frame, triangulate(frame.matches, frame.rig), axis, 0.3)


# Contours.


@pytest.mark.parametrize("camera", RIG.cameras, ids=["left", "right"])
@pytest.mark.parametrize("degrees", [0, 30, 90, 150, 180, 240, 300])
def test_pieces_lie_on_the_sampled_outlines(degrees: int, camera: object) -> None:
    view = RIG.cameras[int(camera is not LEFT)]
    cylinder = Cylinder.seen(
        np.array([640.0, 380.0]), 2.0, math.radians(degrees), 0.2, 0.3, camera=LEFT
    )
    pieces = contour_pieces(Axis.straight(cylinder.point, cylinder.direction), 0.3, view)
    for piece, line in zip(pieces, outline_lines(cylinder, view), strict=True):
        ends = piece.reshape(-1, 2)
        assert len(ends) >= 2
        assert np.abs(ends @ line[:2] + line[2]).max() < 1e-3
        # Clipped to the picture, and reaching to its border.
        assert (ends >= -0.5 - 1e-6).all()
        assert (ends <= [1199.5 + 1e-6, 799.5 + 1e-6]).all()
        border = np.minimum(ends + 0.5, [1199.5, 799.5] - ends).min(axis=1)
        assert border[[0, -1]].max() < 1e-3


@pytest.mark.parametrize("curvature", [0.0, 0.03, -0.05])
@pytest.mark.parametrize("heading", [0.0, 0.9, 1.57, 2.4, 4.0])
def test_exact_segments_along_a_pipe_bear_it_fully(heading: float, curvature: float) -> None:
    found = contours_of(*scene(heading=heading, curvature=curvature))
    assert tuple(found) == ALL
    for contour in found.values():
        # A bend's chord is a little off its arc; the last pixels of a contour give no segment.
        assert contour.share > (0.93 if curvature == 0.0 else 0.8)
        assert contour.share <= 1.0 + 1e-9
        assert contour.length > 400.0


@pytest.mark.parametrize("pixels", [-4.5, -3.0, 0.0, 3.0, 4.5])
def test_support_falls_off_with_the_distance(pixels: float) -> None:
    diver, axis = scene()
    # The pipe runs up the picture; its contours lie off it by nearly as much as it is moved.
    off = np.array([pixels * axis.point[2] / 930.0, 0.0, 0.0])
    moved = Axis.straight(axis.point + off, axis.direction)
    for contour in contours_of(diver, moved).values():
        assert contour.share == pytest.approx(1.0 - abs(pixels) / 6.0, abs=0.05)


@pytest.mark.parametrize("hidden", range(4))
def test_a_contour_that_is_not_seen_is_not_called_visible(hidden: int) -> None:
    seen = [1.0] * 4
    seen[hidden] = 0.0
    diver, axis = scene(replace(EXACT, seen=(seen[0], seen[1], seen[2], seen[3])), heading=0.7)
    support = Support(contour_support(diver.frame(level_pose()), axis, 0.3), 0, 0.0, 0.0, 0.0)
    expected = Contours(15) & ~ALL[hidden]
    assert support.visible == expected
    assert support.contour_share == pytest.approx(0.75, abs=0.06)
    bits, lines = seen_lines(support)
    assert bits == expected
    assert lines.shape == (3, 4)
    assert lines.dtype == np.float32


def test_travelling_the_other_way_swaps_left_and_right() -> None:
    diver, axis = scene(replace(EXACT, seen=(1.0, 0.0, 1.0, 0.0)))
    support = Support(contour_support(diver.frame(level_pose()), axis, 0.3), 0, 0.0, 0.0, 0.0)
    assert support.visible == Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_LEFT
    back = contour_support(diver.frame(level_pose()), axis.reversed(), 0.3)
    turned = Support(back, 0, 0.0, 0.0, 0.0)
    assert turned.visible == Contours.LEFT_IMAGE_RIGHT | Contours.RIGHT_IMAGE_RIGHT
    assert turned.contribution == pytest.approx(support.contribution)


def test_seen_lines_run_along_the_contours_in_bit_order() -> None:
    diver, axis = scene(heading=0.3)
    support = Support(contour_support(diver.frame(level_pose()), axis, 0.3), 0, 0.0, 0.0, 0.0)
    _, lines = seen_lines(support)
    cylinder = Cylinder(axis.point, axis.direction, 0.3)
    expected = [line for camera in RIG.cameras for line in outline_lines(cylinder, camera)]
    for row, line in zip(lines.astype(np.float64), expected, strict=True):
        assert np.abs(row.reshape(2, 2) @ line[:2] + line[2]).max() < 1e-3
        assert np.hypot(*(row[2:] - row[:2])) > 400.0


def test_the_line_of_a_bent_contour_is_the_nearest_one() -> None:
    diver, axis = scene(curvature=0.05, heading=0.3)
    support = Support(contour_support(diver.frame(level_pose()), axis, 0.3), 0, 0.0, 0.0, 0.0)
    _, lines = seen_lines(support)
    shown = [contour for contour in support.contours if contour.bit & support.visible]
    for row, contour in zip(lines.astype(np.float64), shown, strict=True):
        ends = np.concatenate((contour.pieces[0, :2], contour.pieces[-1, 2:]))
        assert mean_distance(contour.pieces, row) < 0.7 * mean_distance(contour.pieces, ends)
        # As long as the contour.
        assert np.abs(row - ends).max() < 30.0
        assert np.isclose(row, ends, atol=1e-3).sum() >= 2


def mean_distance(pieces: Array, line: Array) -> float:
    way = line[2:] - line[:2]
    normal = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    middles = 0.5 * (pieces[:, :2] + pieces[:, 2:])
    return float(np.mean(np.abs((middles - line[:2]) @ normal)))


def test_mono_has_two_contours_and_what_is_out_of_view_none() -> None:
    diver, axis = scene(rig=MONO)
    assert tuple(contours_of(diver, axis)) == ALL[:2]
    far_aside = Axis.straight(axis.point + np.array([4.0, 0.0, 0.0]), axis.direction)
    assert contours_of(diver, far_aside) == {}


def test_no_contours_are_no_share() -> None:
    nothing = Support((), 0, 0.0, 0.0, 0.0)
    assert nothing.contour_share == 0.0
    assert nothing.contribution == 0.0
    assert nothing.visible == Contours.NONE
    assert ContourSupport(Contours.LEFT_IMAGE_LEFT, np.zeros((0, 4)), 0.0, 0.0).share == 0.0
    bits, lines = seen_lines(nothing)
    assert bits == Contours.NONE
    assert lines.shape == (0, 4)


# Surface.


@pytest.mark.parametrize("heading", [0.0, 0.8, 1.57])
@pytest.mark.parametrize("height", [2.0, 3.5])
def test_a_pipe_is_borne_by_its_face(height: float, heading: float) -> None:
    support = judged(*scene(Look(), heading=heading, height=height))
    assert support.face_points > 40
    assert support.face_share > 0.9
    assert support.pierced_share < 0.1
    assert refusal(support, stereo=True) == ""
    assert support_share(support) > 0.8


def test_a_bare_bed_bears_no_pipe() -> None:
    diver, axis = scene(Look())
    bare = Diver(World(diver.world.bed), look=replace(Look(), outliers=0.0))
    support = judged(bare, axis)
    # The bed lies one radius below where the axis should be: it cuts the surface in two lines.
    assert support.face_points > 40
    assert support.face_share < 0.4
    assert support.face_gain < 0.0
    assert refusal(support, stereo=True) == "surface_not_a_pipe"
    assert score(support) < 0.2
    # Not even where the axis is put so low that the bed grazes the pipe's top.
    low = Axis.straight(axis.point + np.array([0.0, 0.0, 0.6]), axis.direction)
    assert refusal(judged(bare, low), stereo=True) == "surface_not_a_pipe"


def test_a_thinner_pipe_or_a_hump_is_refused_under_the_same_axis() -> None:
    _, axis = scene()
    thin = Diver(World.with_pipe(radius=0.12, height=2.18), look=Look())
    assert refusal(judged(thin, axis), stereo=True) != ""
    hump = Diver(World(Bed(-2.3, hump=0.6, width=0.35)), look=Look())
    assert refusal(judged(hump, axis), stereo=True) != ""


def test_points_behind_the_face_pierce_it() -> None:
    diver, axis = scene(Look())
    # The same frame, asked for a pipe 25 cm nearer to the camera: its face would hide all.
    near = Axis.straight(axis.point - np.array([0.0, 0.0, 0.25]), axis.direction)
    assert judged(diver, near).pierced_share > 0.8
    assert judged(diver, axis).pierced_share < 0.1
    assert score(judged(diver, near)) < score(judged(diver, axis)) - 0.5


def test_without_texture_the_contours_speak_alone() -> None:
    support = judged(*scene(replace(Look(), texture=False)))
    assert support.face_points == 0
    assert refusal(support, stereo=True) == ""
    one_image = judged(*scene(replace(Look(), texture=False, seen=(0.9, 0.9, 0.0, 0.0))))
    assert refusal(one_image, stereo=True) != ""


# What is refused, by hand.


def by_hand(shares: tuple[float, ...], *surface: float) -> Support:
    contours = tuple(
        ContourSupport(bit, np.zeros((1, 4)), 500.0 * share, 500.0)
        for bit, share in zip(ALL, shares, strict=False)
    )
    points, share, pierced, gain = surface or (0, 0.0, 0.0, 0.0)
    return Support(contours, int(points), share, pierced, gain)


def test_each_refusal_has_its_word() -> None:
    good = (0.9, 0.9, 0.9, 0.9)
    assert refusal(by_hand(good), stereo=True) == ""
    assert refusal(by_hand(good[:2]), stereo=False) == ""
    assert refusal(by_hand((0.1, 0.1, 0.1, 0.1)), stereo=True) == "too_little_contour"
    assert refusal(by_hand((0.9, 0.0)), stereo=False) == "one_contour_only"
    assert refusal(by_hand((0.9, 0.9, 0.9, 0.0)), stereo=True) == "cameras_disagree"
    assert refusal(by_hand(good, 50, 0.95, 0.0, 2.0), stereo=True) == ""
    assert refusal(by_hand(good, 50, 0.3, 0.0, 2.0), stereo=True) == "surface_not_a_pipe"
    # The clearer the contours, the less must the surface say for a cylinder; never against it.
    fair = (0.4, 0.4, 0.4, 0.4)
    for contours, gain, word in (
        (good, 0.1, ""),
        (good, -0.3, "surface_not_a_pipe"),
        (fair, 0.3, ""),
        (fair, 0.1, "surface_not_a_pipe"),
    ):
        assert refusal(by_hand(contours, 50, 0.95, 0.0, gain), stereo=True) == word
    none = (0.0, 0.0, 0.0, 0.0)
    assert refusal(by_hand(none, 50, 0.95, 0.0, 2.0), stereo=True) == "too_little_contour"


def test_what_is_left_of_a_covered_face_is_judged_by_itself() -> None:
    faint = (0.06, 0.06, 0.06, 0.06)
    # Half of the face is under silt; the rest is clearly a cylinder.
    assert refusal(by_hand(faint, 400, 0.5, 0.0, 0.5), stereo=True) == ""
    # Through a pipe nothing is seen.
    assert refusal(by_hand(faint, 400, 0.5, 0.6, 0.5), stereo=True) == "surface_not_a_pipe"
    # What is left is no better a cylinder than a plane, or is too little to tell.
    assert refusal(by_hand(faint, 400, 0.5, 0.0, 0.1), stereo=True) == "surface_not_a_pipe"
    assert refusal(by_hand(faint, 60, 0.5, 0.0, 0.5), stereo=True) == "surface_not_a_pipe"
    # Without contours it may be a hump, unless a pipe was followed to it.
    none = (0.0, 0.0, 0.0, 0.0)
    assert refusal(by_hand(none, 400, 0.5, 0.0, 0.5), stereo=True) == "too_little_contour"
    assert refusal(by_hand(none, 400, 0.5, 0.0, 0.5), stereo=True, followed=True) == ""


def test_numbers_that_are_none_are_refused() -> None:
    nan = float("nan")
    assert refusal(by_hand((0.9,) * 4, 50, nan, 0.0, 2.0), stereo=True) != ""
    assert refusal(by_hand((0.9,) * 4, 50, 0.95, 0.0, nan), stereo=True) != ""
    assert refusal(by_hand((nan,) * 4), stereo=True) != ""


def test_the_share_of_evidence_runs_from_0_to_1() -> None:
    full = by_hand((1.0,) * 4, 80, 1.0, 0.0, 2.6)
    assert support_share(full) == pytest.approx(1.0)
    assert support_share(by_hand((1.0,) * 4)) == pytest.approx(1.0)
    assert support_share(by_hand((0.0,) * 4)) == 0.0
    assert support_share(by_hand((0.0,) * 4, 80, 0.0, 1.0, -1.0)) == 0.0
    # More of anything is never less.
    steps = [by_hand((c,) * 4, 80, f, 0.0, 1.0) for c in (0.1, 0.3) for f in (0.5, 0.9)]
    shares = [support_share(step) for step in steps]
    assert shares[0] < shares[1] < shares[3]
    assert shares[0] < shares[2] < shares[3]


def test_a_pierced_pipe_and_one_without_a_face_rank_lower() -> None:
    good = by_hand((0.8,) * 4, 80, 0.9, 0.0, 2.0)
    assert score(by_hand((0.8,) * 4, 80, 0.9, 0.4, 2.0)) < score(good)
    assert score(by_hand((0.8,) * 4)) < score(good)


def test_a_strip_as_narrow_as_a_line_has_no_contours() -> None:
    diver, axis = scene(height=2.0)
    frame = diver.frame(level_pose())
    assert contour_support(frame, axis, 0.3)
    far = Axis.straight(axis.point * 60.0, axis.direction)
    assert contour_support(frame, far, 0.3) == ()


def test_mismatches_do_not_make_a_plane_worse() -> None:
    rng = np.random.default_rng(5)
    flat = np.column_stack((rng.uniform(-0.5, 0.5, (300, 2)), np.full(300, 2.0)))
    flat[:, 2] += 0.01 * rng.standard_normal(300)
    flat[:15, 2] += rng.uniform(-1.5, 3.0, 15)
    rays = flat / np.linalg.norm(flat, axis=1)[:, None]
    cost = plane_cost(flat, np.full(300, 0.01), rays)
    assert np.mean(cost[15:]) < 0.6
    assert (cost[:15] > 2.0).mean() > 0.8


def test_the_cost_for_a_plane_agrees_with_a_plain_fit() -> None:
    rng = np.random.default_rng(6)
    points = np.column_stack((rng.uniform(-0.5, 0.5, (200, 2)), np.full(200, 2.0)))
    points[:, 2] += 0.2 * points[:, 0] + rng.normal(0.0, 0.02, 200)
    points[:40, 2] -= rng.uniform(0.1, 0.4, 40)
    depth_sigmas = rng.uniform(0.005, 0.02, 200)
    rays = points / np.linalg.norm(points, axis=1)[:, None]
    cost = plane_cost(points, depth_sigmas, rays)

    sigmas = np.hypot(depth_sigmas, ROUGHNESS)
    weights, normal = np.ones(200), np.array([-0.2, 0.0, 1.0]) / math.hypot(0.2, 1.0)
    centre = np.array([0.0, 0.0, 2.0])
    for width in (12.0, 8.0, 4.0, 4.0, 4.0):
        facing = np.maximum(np.abs(rays @ normal), 0.2)
        residuals = (points - centre) @ normal / np.hypot(depth_sigmas * facing, ROUGHNESS)
        weights = np.square(np.clip(1.0 - np.square(residuals / width), 0.0, None)) / sigmas**2
        centre = (points * weights[:, None]).sum(axis=0) / weights.sum()
        away = points - centre
        normal = np.linalg.eigh((away * weights[:, None]).T @ away)[1][:, 0]
    expected = 16.0 / 6.0 * (1.0 - np.clip(1.0 - np.square(residuals / 4.0), 0.0, None) ** 3)
    # Begun elsewhere, both are near the same plane after a few steps.
    assert cost == pytest.approx(expected, abs=0.1)
    assert np.mean(cost[:40]) > 2.0
    assert np.mean(cost[40:]) < 1.0


@pytest.mark.parametrize("curvature", [0.0, 0.04, -0.06])
def test_a_bent_contour_is_supported_piece_by_piece(curvature: float) -> None:
    diver, axis = scene(curvature=curvature)
    frame = diver.frame(level_pose(), seed=3)
    found = contour_support(frame, axis, 0.3)
    assert len(found) == 4
    segments = (frame.left_segments, frame.right_segments)
    for contour in found:
        seen = segments[int(contour.bit > Contours.LEFT_IMAGE_RIGHT)]
        each = [line_support(seen, line, 6.0, 0.12, np.empty(2000)) for line in contour.pieces]
        assert contour.contribution == pytest.approx(sum(part for part, _ in each), rel=1e-9)
        assert contour.length == pytest.approx(sum(length for _, length in each))


def test_a_surface_at_another_scale_leaves_clear_contours_alone() -> None:
    diver, axis = scene()
    frame = diver.frame(level_pose())
    surface = triangulate(frame.matches, frame.rig)
    face = surface.subset(on_face(surface, LEFT, axis, 0.3))
    assert depth_ratio(face, LEFT, axis, 0.3) == pytest.approx(1.0, abs=0.005)
    # As a baseline that is a fifth too long gives it.
    longer = replace(surface, points=1.2 * surface.points)
    assert depth_ratio(replace(face, points=1.2 * face.points), LEFT, axis, 0.3) == pytest.approx(
        1.2, abs=0.006
    )
    alone = judge(frame, longer, axis, 0.3)
    assert alone.face_points == 0
    assert refusal(alone, stereo=True) == ""
    # Not where the contours are faint: then it speaks against the axis.
    faint = replace(frame, left_segments=frame.left_segments[:0])
    assert judge(faint, longer, axis, 0.3).face_points > 0


@pytest.mark.parametrize("turned", [False, True])
def test_the_line_of_a_bent_contour_is_its_least_squares(turned: bool) -> None:
    x = np.linspace(100.0, 700.0, 9)
    knots = np.column_stack((x, 300.0 + 0.2 * x + 1e-4 * np.square(x - 350.0)))
    if turned:
        knots = knots[:, ::-1]
    pieces = np.hstack((knots[:-1], knots[1:]))
    along = int(turned)
    # Five points in the middles of fifths of each piece, by its length.
    shares = np.arange(0.1, 1.0, 0.2)[:, None, None]
    points = (pieces[:, :2] + shares * (pieces[:, 2:] - pieces[:, :2])).reshape(-1, 2)
    lengths = np.tile(np.linalg.norm(pieces[:, 2:] - pieces[:, :2], axis=1), 5)
    fit = np.polyfit(points[:, along], points[:, 1 - along], 1, w=np.sqrt(lengths))
    line = _nearest_line(pieces).reshape(2, 2)
    assert np.allclose(line[:, along], [100.0, 700.0])
    assert np.allclose(line[:, 1 - along], np.polyval(fit, [100.0, 700.0]))
