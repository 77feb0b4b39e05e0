"""Contour errors in pixels: lines whose errors are known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation import Evaluation, evaluate
from pipeline_tracker.evaluation.contour_error import LINES, beside, measure_contours
from pipeline_tracker.evaluation.contours import TrueContours
from pipeline_tracker.evaluation.view import contour_points
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import clip_line_to_view, visible_generatrices
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import Contours, Mode, PipeSegment

Array = NDArray[np.float64]
OUTSIDE, HIDDEN, VISIBLE = 0, 1, 2

# An upright contour at x = 100 of 11 points, 10 px apart, and one at x = 200.
LINE = np.stack((np.full(11, 100.0), 10.0 * np.arange(11)), axis=1)
BOTH = np.stack((LINE, LINE + np.array([100.0, 0.0])))


def segment(lines: dict[Contours, list[float]]) -> PipeSegment:
    bits = Contours.NONE
    for bit in lines:
        bits |= bit
    rows = [lines[bit] for bit in sorted(lines)]
    return PipeSegment(
        0,
        Mode.TRACKING,
        0,
        np.zeros(3),
        np.array([0.5, 0.0, 0.0]),
        0.3,
        np.eye(4),
        1.0,
        bits,
        np.array(rows, np.float32).reshape(-1, 4),
    )


def flags(value: int = VISIBLE) -> NDArray[np.int64]:
    return np.full((2, 11), value)


def test_a_line_aside_is_off_by_its_distance_on_its_own_side() -> None:
    published = segment(
        {Contours.LEFT_IMAGE_LEFT: [103, 0, 103, 100], Contours.LEFT_IMAGE_RIGHT: [199, 0, 199, 99]}
    )
    result = measure_contours(published, (TrueContours(BOTH, flags()), None), reverse=False)
    assert set(result) == {"left_image_left", "left_image_right"}
    left, right = result["left_image_left"], result["left_image_right"]
    assert left.error == left.worst == left.visible_error == pytest.approx(3.0)
    assert right.error == pytest.approx(1.0)
    assert not left.wrong_side
    assert not left.not_visible
    assert left.missed is False


def test_against_the_listed_direction_left_is_right() -> None:
    published = segment({Contours.LEFT_IMAGE_LEFT: [203, 0, 203, 100]})
    truths = (TrueContours(BOTH, flags()), None)
    assert measure_contours(published, truths, reverse=True)["left_image_left"].error == 3.0
    other = measure_contours(published, truths, reverse=False)["left_image_left"]
    assert other.wrong_side
    assert other.error == pytest.approx(103.0)


def test_only_beside_what_is_inside_or_visible() -> None:
    # The line runs away from the contour: 0 px at the top, 10 px at the bottom.
    published = segment({Contours.LEFT_IMAGE_LEFT: [100, 0, 110, 100]})
    seen = flags()
    seen[0, 5:] = HIDDEN
    seen[0, 8:] = OUTSIDE
    line = measure_contours(published, (TrueContours(BOTH, seen), None), reverse=False)
    result = line["left_image_left"]
    # Inside down to y = 75, visible down to y = 45: means at half of that.
    assert result.error == pytest.approx(3.75, abs=0.25)
    assert result.worst == pytest.approx(7.5, abs=0.25)
    assert result.ends == pytest.approx(3.75, abs=0.25)
    assert result.visible_error == pytest.approx(2.25, abs=0.25)


def test_the_ends_of_a_chord_are_on_a_bent_contour() -> None:
    bent = BOTH.copy()
    bent[0, :, 0] += 0.002 * (LINE[:, 1] - 50.0) ** 2
    published = segment({Contours.LEFT_IMAGE_LEFT: [105, 0, 105, 100]})
    truths = (TrueContours(bent, flags()), None)
    result = measure_contours(published, truths, reverse=False)["left_image_left"]
    assert result.ends == pytest.approx(0.0, abs=1e-6)
    assert result.worst == pytest.approx(5.0, abs=0.1)


def test_beyond_an_end_of_the_contour_nothing_is_measured() -> None:
    published = segment({Contours.LEFT_IMAGE_LEFT: [102, -500, 102, 500]})
    truths = (TrueContours(BOTH, flags()), None)
    result = measure_contours(published, truths, reverse=False)["left_image_left"]
    assert result.worst == pytest.approx(2.0)
    interrupted = BOTH.copy()
    interrupted[0, 4:7] = np.nan
    points = np.array([[100.0, y] for y in (-1.0, 15.0, 45.0, 65.0, 75.0, 101.0)])
    _, found = beside(points, interrupted[0], flags()[0])
    assert (found == VISIBLE).tolist() == [False, True, False, False, True, False]


@pytest.mark.parametrize("value", [HIDDEN, OUTSIDE])
def test_a_line_of_what_is_nowhere_visible_is_counted(value: int) -> None:
    published = segment({Contours.LEFT_IMAGE_LEFT: [103, 0, 103, 100]})
    seen = flags(value)
    result = measure_contours(published, (TrueContours(BOTH, seen), None), reverse=False)
    assert result["left_image_left"].not_visible
    assert result["left_image_left"].visible_error is None
    assert (result["left_image_left"].error is None) == (value == OUTSIDE)


def test_visible_contours_without_a_line_are_missed() -> None:
    seen = flags()
    seen[1] = HIDDEN
    result = measure_contours(segment({}), (TrueContours(BOTH, seen), None), reverse=False)
    assert result["left_image_left"].missed
    assert not result["left_image_right"].missed
    unknown = TrueContours(BOTH, flags(), hidden_known=False)
    line = measure_contours(segment({}), (unknown, None), reverse=False)["left_image_left"]
    assert line.missed is None


# In a whole replay


def with_contours(frame: Any, sea: Any, mounting: Pose, shift: float) -> Any:
    """The frame with the lines of a straight pipe through its segment, moved in x by pixels."""
    to_camera = mounting.inverse()
    start, end = to_camera.apply(frame.segment.start), to_camera.apply(frame.segment.end)
    way = (end - start) / np.linalg.norm(end - start)
    bits, rows = Contours.NONE, []
    for bit, image, side in LINES.values():
        camera: Camera = sea.cameras[image]
        edges = visible_generatrices(start, way, 0.3, camera.centre)
        clipped = None if edges is None else clip_line_to_view(edges[side], way, camera)
        if clipped is None:
            continue
        ends = edges[side] + np.array(clipped)[:, None] * way
        bits |= bit
        rows.append((camera.project(ends) + np.array([shift, 0.0])).ravel())
    contours = np.array(rows, np.float32).reshape(-1, 4)
    return replace(frame, segment=replace(frame.segment, visible_contours=bits, contours=contours))


def measure(sea: Any, tmp_path: Path, shift: float, **options: Any) -> Evaluation:
    """A straight pipe; each line published is the true one, moved in x."""
    sea.centerline[:, 1], sea.centerline[:, 2] = 0.4, 0.2
    frames = [with_contours(frame, sea, sea.mounting, shift) for frame in sea.frames()]
    truth = sea.write_truth(tmp_path / "truth", **options)
    return evaluate(sea.write_replay(tmp_path / "replay", frames), truth)


@pytest.mark.parametrize("leave_out", [(), ("/stereo",)])
def test_without_contours_in_the_bag_they_are_computed(
    sea: Any, tmp_path: Path, leave_out: tuple[str, ...]
) -> None:
    # The cameras come from the bag, or from the replay where the bag has none.
    sea.images = [np.zeros((128, 160), np.uint8)] * 12
    figures = measure(sea, tmp_path, 0.0, leave_out=leave_out).groups["all"].contours
    assert set(figures) == {"all", *LINES}
    assert figures["all"].measured == figures["all"].lines > 24
    assert figures["all"].worst_px == pytest.approx(0.0, abs=1e-3)
    assert figures["all"].wrong_side == figures["all"].contours_not_visible == 0
    assert figures["all"].visible_error_px is None
    assert figures["all"].missed is None


def test_lines_moved_by_2_px_are_off_by_their_distance(sea: Any, tmp_path: Path) -> None:
    result = measure(sea, tmp_path, 2.0)
    for name, line in result.groups["all"].contours.items():
        # In x by 2 px: across the line, which leans, by less.
        assert 1.0 < line.error_px.max <= 2.0 + 1e-3, name
        assert line.error_px.mean <= line.error_px.p95 <= line.error_px.max
    told = result.per_frame[3].contours_px
    assert told
    assert all(1.0 < value <= 2.0 + 1e-3 for value in told.values())


def test_a_segment_whose_contours_do_not_fit_its_bits_is_refused(sea: Any, tmp_path: Path) -> None:
    frames = sea.frames()
    frames[2] = replace(
        frames[2], segment=replace(frames[2].segment, visible_contours=Contours.LEFT_IMAGE_LEFT)
    )
    truth = sea.write_truth(tmp_path / "truth")
    with pytest.raises(EvaluationError, match="number of contours is 0, expected 1"):
        evaluate(sea.write_replay(tmp_path / "replay", frames), truth)


def test_contours_of_the_simulator_are_those_that_are_computed() -> None:
    pytest.importorskip("pipeline_tracker.simulation.truth")
    from pipeline_tracker.simulation.truth import contour_points as simulated

    class Straight:
        """Along x, as the simulator's axis."""

        radius = 0.3

        def points(self, s: Array) -> Array:
            return np.stack((s, np.full_like(s, 0.2), np.zeros_like(s)), axis=-1)

        def frames(self, s: Array) -> tuple[Array, Array, Array]:
            unit = np.tile(np.eye(3), (len(s), 1, 1))
            return unit[:, 0], -unit[:, 1], unit[:, 2]

    pose = Pose.from_rpy([0.3, -0.5, 2.0], [math.pi - 0.4, 0.1, -1.4])
    s = np.linspace(-1.0, 2.0, 7)
    axis: Any = Straight()
    expected = pose.inverse().apply(simulated(axis, s, pose.translation)[0])
    points = pose.inverse().apply(axis.points(s))
    tangents = pose.inverse().rotate(np.tile([1.0, 0.0, 0.0], (7, 1)))
    found, outside = contour_points(points, tangents, 0.3, Camera(1, 1, 0, 0, 2, 2))
    assert outside.all()
    np.testing.assert_allclose(found, expected, atol=1e-12)
