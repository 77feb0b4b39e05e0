"""Techniques 1, 2 and 3 on a frame whose contours are known, with their covariance (4.2.4)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, Evidence, Prior, across, fit_axis
from pipeline_tracker.evidence import (
    EDGE_OUTSIDE,
    contour_rays,
    distances_from_axis,
    rays_to_axis,
)
from pipeline_tracker.face import SPAN, on_face, point_sigmas, without_sag
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.jit import compiled
from pipeline_tracker.pipe_segment import middle_of_view
from pipeline_tracker.recognition.techniques import technique1, technique2, technique3
from pipeline_tracker.surface import LEAST_FACE_POINTS, SurfacePoints
from pipeline_tracker.types import VectorizedStereo

Array = NDArray[np.float64]

REFERENCE_WIDTH = 1200.0
_GATE = 3.0
# Contours are straight lines so far to each side of the middle, m; where too little of one is seen
# there, further. The least of it, in sights.
_SPANS, _LEAST_SIGHTS = (0.8, SPAN), 2.0
# Robust widths of a line's fit, px at 1200 px width or more.
_LINE_WIDTHS = (3.0, 2.0, 1.2, 1.2, 1.2, 1.2)
# Standard deviation of a contour line's place at each of its ends, px at 1200 px width.
_LINE_SIGMA = 0.5
# Technique 1: the pipe is taken as straight so far to each side of the middle, m, and its direction
# from the face where that has so many points.
_STRAIGHT, _MANY_POINTS = 0.6, 40
_MODEL_SIGMAS = np.array([0.002, 0.002, 0.003, 0.003])


def contour_line(
    segments: NDArray[np.float32], camera: Camera, axis: Axis, radius: float, side: int
) -> Array | None:
    """Fit the image line of one contour to the segments along its prediction.

    Args:
        segments: (N, 4) float32, px.
        camera: their camera.
        axis: the predicted axis.
        radius: m.
        side: -1 left, +1 right.

    Returns:
        (a, b, c), or None where too little of it is seen.
    """
    scale = camera.width / REFERENCE_WIDTH
    gate = max(2.0, _GATE * scale)
    for span in _SPANS:
        rays, sides, weights = contour_rays(segments, camera, axis, radius, gate, span=span)
        mine = sides == side
        if float(weights[mine].sum()) >= _LEAST_SIGHTS:
            break
    else:
        return None
    rays, weights = rays[mine], weights[mine]
    pixels = np.stack(
        (
            rays[:, 0] / rays[:, 2] * camera.fx + camera.cx,
            rays[:, 1] / rays[:, 2] * camera.fy + camera.cy,
        ),
        axis=1,
    )
    line = np.empty(3)
    _fit_line(np.ascontiguousarray(pixels), weights, max(1.0, scale), line)
    inward = np.sign(line[:2] @ camera.project(axis.point) + line[2])
    line[2] -= inward * EDGE_OUTSIDE * scale
    return line


@compiled
def _fit_line(pixels: Array, weights: Array, scale: float, line: Array) -> None:
    """Fit a line to pixels of which many lie beside it.

    Args:
        pixels: (N, 2), px.
        weights: (N,).
        scale: of the robust widths.
        line: (a, b, c), filled; a² + b² = 1.
    """
    line[:] = 0.0
    for k in range(len(_LINE_WIDTHS)):
        width = scale * _LINE_WIDTHS[max(k - 1, 0)]
        total, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(pixels.shape[0]):
            # From the first pixel: sums of squares of small numbers.
            x, y = pixels[i, 0] - pixels[0, 0], pixels[i, 1] - pixels[0, 1]
            w = weights[i]
            if k > 0:
                # Edges beside the contour (growth, a shadow) are many: those that agree win, not
                # the mean.
                off = (line[0] * pixels[i, 0] + line[1] * pixels[i, 1] + line[2]) / width
                w *= (1.0 / (1.0 + off * off)) ** 2
            total += w
            sx += w * x
            sy += w * y
            sxx += w * x * x
            sxy += w * x * y
            syy += w * y * y
        mx, my = sx / total, sy / total
        cxx, cxy, cyy = sxx / total - mx * mx, sxy / total - mx * my, syy / total - my * my
        # The direction in which they scatter most, and the normal across it.
        along = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy)
        line[0], line[1] = -np.sin(along), np.cos(along)
        line[2] = -line[0] * (mx + pixels[0, 0]) - line[1] * (my + pixels[0, 1])


def _pair(
    frame: VectorizedStereo, number: int, axis: Axis, radius: float
) -> tuple[Array, Array] | None:
    segments = (frame.left_segments, frame.right_segments)[number]
    camera = frame.rig.cameras[number]
    lines = [contour_line(segments, camera, axis, radius, side) for side in (-1, 1)]
    if lines[0] is None or lines[1] is None:
        return None
    return lines[0], lines[1]


def _numeric_covariance(
    solve: Callable[[list[Array]], Axis | None],
    lines: list[tuple[Array, Camera]],
    axis: Axis,
    vertical: Array,
) -> Array:
    """Covariance of an axis from that of its contour lines, by moving each end of each line."""
    left, up = across(axis.direction, vertical)
    covariance = np.diag(np.square(_MODEL_SIGMAS))
    for index, (line, camera) in enumerate(lines):
        sigma = max(0.3, _LINE_SIGMA * camera.width / REFERENCE_WIDTH)
        along = np.array([-line[1], line[0]])
        foot = -line[2] * line[:2]
        middle = np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])
        middle = foot + along * float((middle - foot) @ along)
        half = 0.4 * min(camera.width, camera.height)
        for sign in (-1.0, 1.0):
            ends = [middle - half * along, middle + half * along]
            ends[int(sign > 0)] = ends[int(sign > 0)] + sigma * line[:2]
            step = ends[1] - ends[0]
            normal = np.array([step[1], -step[0]]) / float(np.linalg.norm(step))
            moved = [entry for entry, _ in lines]
            moved[index] = np.array([normal[0], normal[1], -float(normal @ ends[0])])
            other = solve(moved)
            if other is None:
                continue
            if float(other.direction @ axis.direction) < 0:
                other = other.reversed()
            there = other.moved(float((axis.point - other.point) @ other.direction))
            off, turn = there.point - axis.point, there.direction - axis.direction
            delta = np.array([off @ left, off @ up, turn @ left, turn @ up])
            covariance += np.outer(delta, delta)
    return covariance


def _direction_of_contour(
    surface: SurfacePoints, camera: Camera, axis: Axis, radius: float
) -> Array | None:
    """Direction of the pipe from matches on a contour that both cameras see (technique 1).

    The right contour of the left camera is seen by the right one too. A contour along the rows
    cannot be matched.
    """
    measured = rays_to_axis(surface.rays, camera, axis)
    pixels = (measured[:, 0] - radius) * camera.fx / np.maximum(measured[:, 1], 0.1)
    near = np.abs(pixels) < 3.0 * max(1.0, camera.width / REFERENCE_WIDTH)
    # Beside the contour the bed is seen, far behind it.
    _, distance = distances_from_axis(surface.points, axis)
    near &= np.abs(distance - radius) < 4.0 * point_sigmas(surface, axis)
    points = surface.points[near]
    if len(points) < 6:
        return None
    centre = np.median(points, axis=0)
    weights = np.ones(len(points))
    direction = axis.direction
    for _ in range(5):
        centre = (points * weights[:, None]).sum(axis=0) / weights.sum()
        away = points - centre
        _, vectors = np.linalg.eigh((away * weights[:, None]).T @ away)
        direction = vectors[:, 2]
        off = np.linalg.norm(away - np.outer(away @ direction, direction), axis=1)
        weights = 1.0 / (1.0 + np.square(off / max(float(np.median(off)), 1e-4)))
    spread = float(np.ptp((points - centre) @ direction))
    if spread < 2.0 * radius or abs(float(direction @ axis.direction)) < 0.98:
        return None
    return direction


def _direction_of_surface(
    face: SurfacePoints, sigmas: Array, known: Axis, radius: float, vertical: Array
) -> Array | None:
    """Direction of the pipe from the points on its face, where there are many (technique 1).

    A contour is one line of points at the border of what can be matched; the face is broad.
    """
    if len(face.points) < _MANY_POINTS:
        return None
    none = np.zeros(0)
    rays = np.zeros((0, 3))
    evidence = Evidence(face.points, sigmas, rays, rays, none, none, none)
    stiff = Prior(
        Axis.straight(known.point, known.direction), np.array([10.0, 10.0, 3.0, 3.0, 1e-6, 1e-6])
    )
    fit = fit_axis(stiff.axis, radius, evidence, vertical, stiff, (6.0, 4.0, 4.0))
    direction = fit.axis.direction
    return direction if abs(float(direction @ known.direction)) > 0.98 else None


def solve_by_technique(
    technique: int,
    frame: VectorizedStereo,
    surface: SurfacePoints,
    known: Axis,
    radius: float,
    vertical: Array,
) -> tuple[Axis, Array] | None:
    """Compute the axis by one of the paper's techniques, its contours being identified.

    Args:
        technique: 1, 2 or 3.
        frame: the vectorized pair.
        surface: its triangulated matches.
        known: the axis that tells where each contour is.
        radius: m.
        vertical: unit vector up, left optical frame.

    Returns:
        The axis along ``known`` with its origin in the middle of the view, and its 4 x 4
        covariance; None where the technique does not apply to what is seen. The covariance has
        what the axis is off ``known``: beside contours run edges of shadows and of the pipe's
        foot, which the paper's techniques cannot tell from them.
    """
    rig = frame.rig
    axis: Axis | None = None
    lines: list[tuple[Array, Camera]] = []
    if technique == 1:
        found = _by_surface(surface, rig.left, known, radius, vertical)
        return None if found is None else (found[0], found[1] + _apart(found[0], known, vertical))
    if technique == 2:
        pair, camera = (_pair(frame, 0, known, radius), rig.left)
        if pair is None and rig.right is not None:
            pair, camera = (_pair(frame, 1, known, radius), rig.right)
        if pair is None:
            return None
        lines = [(line, camera) for line in pair]
        seen = camera.project(known.point)

        def solve(moved: list[Array]) -> Axis | None:
            return technique2(moved[0], moved[1], camera, radius, seen)

    else:
        if rig.right is None:
            return None
        left_pair, right_pair = (_pair(frame, number, known, radius) for number in (0, 1))
        if left_pair is None or right_pair is None:
            return None
        lines = [(line, rig.left) for line in left_pair]
        lines += [(line, rig.right) for line in right_pair]

        def solve(moved: list[Array]) -> Axis | None:
            return technique3((moved[0], moved[1]), (moved[2], moved[3]), rig)

    axis = solve([line for line, _ in lines])
    if axis is None:
        return None
    axis = _like(axis, known, rig.left)
    covariance = _numeric_covariance(solve, lines, axis, vertical)
    return axis, covariance + _apart(axis, known, vertical)


def _apart(axis: Axis, known: Axis, vertical: Array) -> Array:
    """Return the squares, (4, 4), of how far an axis is off the known one, at its origin."""
    left, up = across(axis.direction, vertical)
    there = known.moved(float((axis.point - known.point) @ known.direction))
    off, turn = axis.point - there.point, axis.direction - there.direction
    step = np.array([off @ left, off @ up, turn @ left, turn @ up])
    return np.outer(step, step)


def _like(axis: Axis, known: Axis, camera: Camera) -> Axis:
    """Turn an axis along the known one and put its origin in the middle of the view."""
    if float(axis.direction @ known.direction) < 0:
        axis = axis.reversed()
    axis = axis.moved(float((known.point - axis.point) @ axis.direction))
    return axis.moved(middle_of_view(axis, camera))


def _by_surface(
    surface: SurfacePoints, camera: Camera, known: Axis, radius: float, vertical: Array
) -> tuple[Axis, Array] | None:
    face = surface.subset(on_face(surface, camera, known, radius))
    # The technique knows no bend: only what is near the middle is straight.
    along = (face.points - known.point) @ known.direction
    near = np.abs(along) < _STRAIGHT
    face = face.subset(near) if near.sum() >= LEAST_FACE_POINTS else face
    if len(face.points) < LEAST_FACE_POINTS:
        return None
    face = without_sag(face, camera, known, radius)
    sigmas = point_sigmas(face, known)
    direction = _direction_of_surface(face, sigmas, known, radius, vertical)
    if direction is None:
        direction = _direction_of_contour(surface, camera, known, radius)
    if direction is None:
        direction = known.direction
    axis = technique1(face.points, sigmas, direction, radius, vertical)
    if axis is None:
        return None
    axis = _like(axis, known, camera)
    left, up = across(axis.direction, vertical)
    normals, distance = distances_from_axis(face.points, axis)
    near = np.abs(distance - radius) < 4.0 * sigmas
    if int(near.sum()) < LEAST_FACE_POINTS:
        return None
    along = (face.points[near] - axis.point) @ axis.direction
    design = np.stack(
        (
            normals[near] @ left,
            normals[near] @ up,
            along * (normals[near] @ left),
            along * (normals[near] @ up),
        ),
        axis=1,
    )
    design /= sigmas[near][:, None]
    information = design.T @ design + np.diag([1e-2, 1e-2, 1.0, 1.0])
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return axis, covariance + np.diag(np.square(_MODEL_SIGMAS))
