"""How well a pair of pictures bears an axis: its surface, its contours, and the bed beside it.

A number of this module is a share of what was to be expected, so that frames can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import (
    REFERENCE_WIDTH,
    distances_from_axis,
    on_face,
    point_sigmas,
    rays_to_axis,
    without_sag,
)
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import clip_line_to_view, visible_generatrices
from pipeline_tracker.surface import SurfacePoints
from pipeline_tracker.types import Contours, Float32Array, VectorizedStereo
from pipeline_tracker.voting import line_support

Array = NDArray[np.float64]

# Thresholds of 4.1.3: R in px of a picture 1200 px wide, A in rad.
DISTANCE = 6.0
ANGLE = 0.12
# A strip narrower than this many R has one line for both contours.
_LEAST_WIDTH = 2.5
# A contour is called visible from this share of its length in view.
VISIBLE_SHARE = 0.25
# A contour may be in view where the axis is not: the view is widened by this share of the width.
_BORDER = 0.5
REACH = 6.0
_PIECES = 8
_WIDTH = 4.0
# A surface at another scale than the contours: shares of its points on the pipe before and after
# it is scaled, its gain, the scales looked at, and the least share of each contour.
_OTHER_SCALE_SHARE, _OTHER_SCALE_GAIN = 0.3, -0.1
_SCALES = (0.65, 1.55)
_CLEAR_SHARE = 0.35
_FULL_COST = _WIDTH * _WIDTH / 6.0
# Planes through three points that are tried before a fit, and points that judge them.
_TRIPLES, _JURY = 64, 100

BITS = (
    (Contours.LEFT_IMAGE_LEFT, Contours.LEFT_IMAGE_RIGHT),
    (Contours.RIGHT_IMAGE_LEFT, Contours.RIGHT_IMAGE_RIGHT),
)


@dataclass(frozen=True)
class ContourSupport:
    """Support of one contour in one image.

    Attributes:
        bit: which contour it is.
        pieces: (K, 4) float64, the predicted contour in the image, px, straight piece by piece.
        contribution: sum of contributions (4.1.3), px.
        length: visible length, px.
    """

    bit: Contours
    pieces: Array
    contribution: float
    length: float

    @property
    def share(self) -> float:
        """Contribution over visible length, 0 to 1."""
        return self.contribution / self.length if self.length > 0 else 0.0


@dataclass(frozen=True)
class Support:
    """What a vectorized pair has for and against an axis.

    Attributes:
        contours: the two or four contours, those in view.
        face_points: matched points where the pipe's face should be; 0 where they are too few or
            too uncertain to tell its shape.
        face_share: share of them that lie on it; 0 without points.
        pierced_share: share of them that lie inside the pipe or behind it.
        face_gain: how much better the cylinder explains them than a plane does, per point, in
            units of the robust cost; at most about 2.7, negative where the plane is better.
    """

    contours: tuple[ContourSupport, ...]
    face_points: int
    face_share: float
    pierced_share: float
    face_gain: float

    @property
    def contour_share(self) -> float:
        """Share of all contours' visible length that segments support, 0 to 1."""
        length = sum(c.length for c in self.contours)
        return sum(c.contribution for c in self.contours) / length if length > 0 else 0.0

    @property
    def contribution(self) -> float:
        """Sum of contributions to all contours (the paper's total), px."""
        return sum(c.contribution for c in self.contours)

    @property
    def visible(self) -> Contours:
        """Which contours are seen."""
        bits = Contours.NONE
        for contour in self.contours:
            if contour.share >= VISIBLE_SHARE:
                bits |= contour.bit
        return bits


def contour_pieces(axis: Axis, radius: float, camera: Camera) -> list[Array]:
    """Project the two visible boundaries of a bent axis, piece by piece (4.1.2).

    Args:
        axis: the axis, left optical frame.
        radius: m.
        camera: the camera.

    Returns:
        For the left and for the right contour (K, 4) x1 y1 x2 y2, px, clipped to the image; K is
        0 where it is out of view.
    """
    out: list[list[Array]] = [[], []]
    view = clip_line_to_view(axis.point, axis.direction, camera, margin=-_BORDER * camera.width)
    if view is None:
        return [np.zeros((0, 4)), np.zeros((0, 4))]
    # Towards the vanishing point the pipe is a point; there is no need to go there.
    reach = REACH * max(1.0, float(axis.point[2]))
    bounds = np.clip(view, -reach, reach)
    straight = float(np.linalg.norm(axis.bend)) < 1e-9
    knots = bounds if straight else np.linspace(bounds[0], bounds[1], _PIECES + 1)
    for t0, t1 in pairwise(knots):
        middle = 0.5 * (t0 + t1)
        point, direction = axis.at(middle), axis.tangent(middle)
        edges = visible_generatrices(point, direction, radius, camera.centre)
        if edges is None:
            continue
        half = 0.5 * (t1 - t0)
        for side, edge in enumerate(edges):
            # The section through the piece's own middle, not through the nearest point.
            start = edge + direction * float((point - edge) @ direction)
            seen = clip_line_to_view(start, direction, camera)
            if seen is None:
                continue
            low, high = max(seen[0], -half), min(seen[1], half)
            if low < high:
                ends = camera.project(np.stack((start + low * direction, start + high * direction)))
                out[side].append(ends.reshape(4))
    return [np.array(pieces).reshape(-1, 4) for pieces in out]


def contour_support(
    frame: VectorizedStereo,
    axis: Axis,
    radius: float,
    distance: float = DISTANCE,
    angle: float = ANGLE,
) -> tuple[ContourSupport, ...]:
    """Vote for the contours of an axis in the images (4.1.2, 4.1.3).

    Args:
        frame: the vectorized pair.
        axis: the axis, left optical frame.
        radius: m.
        distance: R, px at 1200 px width.
        angle: A, rad.

    Returns:
        The contours in view, left image first; none of a pipe too far to tell its two contours
        apart.
    """
    found = []
    segments = (frame.left_segments, frame.right_segments)
    for number, camera in enumerate(frame.rig.cameras):
        scratch = np.empty(int(np.hypot(camera.width, camera.height)) + 4)
        scaled = max(distance * camera.width / REFERENCE_WIDTH, 2.5)
        away = float(np.linalg.norm(axis.point - camera.centre))
        if 2.0 * radius * camera.fx < _LEAST_WIDTH * scaled * away:
            continue
        pieces = contour_pieces(axis, radius, camera)
        for side in (0, 1):
            total, length = 0.0, 0.0
            for piece in pieces[side]:
                part, own = line_support(segments[number], piece, scaled, angle, scratch)
                total += part
                length += own
            if length > 0:
                bit = BITS[number][side]
                found.append(ContourSupport(bit, pieces[side], total, length))
    return tuple(found)


def _cost(residuals: Array) -> Array:
    inside = np.clip(1.0 - np.square(residuals / _WIDTH), 0.0, None)
    cost: Array = _FULL_COST * (1.0 - inside**3)
    return cost


def _plane_cost(points: Array, depth_sigmas: Array, rays: Array) -> Array:
    """Robust cost of each point for the best plane through the points, same noise assumed.

    Begun from the best of many planes through three points: mismatches far off would tilt a fit to
    all, and make anything better than a plane.
    """
    sigmas = np.hypot(depth_sigmas, 0.003)
    centre, normal = _plane_through_most(points, sigmas)
    cost = np.full(len(points), _FULL_COST)
    for width in (12.0, 8.0, _WIDTH, _WIDTH, _WIDTH):
        facing = np.maximum(np.abs(rays @ normal), 0.2)
        residuals = ((points - centre) @ normal) / np.hypot(depth_sigmas * facing, 0.003)
        cost = _cost(residuals)
        weights = np.square(np.clip(1.0 - np.square(residuals / width), 0.0, None)) / sigmas**2
        total = float(weights.sum())
        if np.count_nonzero(weights) < 3 or not total > 0.0:
            break
        centre = (points * weights[:, None]).sum(axis=0) / total
        away = points - centre
        _, vectors = np.linalg.eigh((away * weights[:, None]).T @ away)
        normal = vectors[:, 0]
    return cost


def _plane_through_most(points: Array, sigmas: Array) -> tuple[Array, Array]:
    """Return point and normal of the plane through three of the points that the others like best.

    The triples are the same for the same number of points.
    """
    rng = np.random.default_rng(len(points))
    triples = points[rng.integers(0, len(points), (_TRIPLES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 1e-9
    if not usable.any():
        return points.mean(axis=0), np.array([0.0, 0.0, 1.0])
    normals = normals[usable] / lengths[usable, None]
    some = np.arange(0, len(points), max(1, len(points) // _JURY))
    heights = points[some] @ normals.T - np.einsum("ij,ij->i", triples[usable, 0], normals)
    best = int(np.argmin(_cost(heights / sigmas[some, None]).sum(axis=0)))
    return triples[usable][best, 0], normals[best]


def judge(frame: VectorizedStereo, surface: SurfacePoints, axis: Axis, radius: float) -> Support:
    """Collect what a vectorized pair has for and against an axis.

    Args:
        frame: the vectorized pair.
        surface: its triangulated matches.
        axis: the axis, left optical frame.
        radius: m.
    """
    contours = contour_support(frame, axis, radius)
    face = surface.subset(on_face(surface, frame.rig.left, axis, radius))
    alone = Support(contours, 0, 0.0, 0.0, 0.0)
    if not face.tells_shape(radius):
        return alone
    plane = _plane_cost(face.points, face.depth_sigmas, face.rays)
    face = without_sag(face, frame.rig.left, axis, radius)
    support = _face_support(contours, face, axis, radius, plane)
    if support.face_share < _OTHER_SCALE_SHARE and _all_clear(contours):
        # Four clear contours, and a surface of the right shape at another distance: diameter and
        # baseline do not go together. Then the surface tells nothing of this pipe's depth.
        scale = depth_ratio(face, frame.rig.left, axis, radius)
        if _SCALES[0] < scale < _SCALES[1]:
            scaled = replace(
                face, points=face.points / scale, depth_sigmas=face.depth_sigmas / scale
            )
            same = _face_support(contours, scaled, axis, radius, plane)
            if same.face_share >= 1.0 - _OTHER_SCALE_SHARE and same.face_gain >= _OTHER_SCALE_GAIN:
                return alone
    return support


def depth_ratio(face: SurfacePoints, camera: Camera, axis: Axis, radius: float) -> float:
    """Return how far the points of a face are by stereo over how far the axis says, the median.

    Args:
        face: points on the pipe's face, N >= 1.
        camera: the left camera.
        axis: the axis, left optical frame.
        radius: m.
    """
    measured = rays_to_axis(face.rays, camera, axis)
    rise = np.sqrt(np.maximum(radius**2 - np.square(measured[:, 0]), 0.0))
    slant = np.sqrt(np.maximum(1.0 - np.square(face.rays @ axis.direction), 0.05))
    expected = np.maximum(measured[:, 1] - rise / slant, 0.05)
    return float(np.median(np.linalg.norm(face.points, axis=1) / expected))


def _all_clear(contours: tuple[ContourSupport, ...]) -> bool:
    return len(contours) == 4 and min(c.share for c in contours) >= _CLEAR_SHARE


def _face_support(
    contours: tuple[ContourSupport, ...],
    face: SurfacePoints,
    axis: Axis,
    radius: float,
    plane: Array,
) -> Support:
    _, distance = distances_from_axis(face.points, axis)
    residuals = (distance - radius) / point_sigmas(face, axis)
    on = float(np.mean(np.abs(residuals) < _WIDTH))
    # What lies behind the face, inside the pipe or seen through it.
    behind = residuals < -_WIDTH
    depth = np.linalg.norm(face.points, axis=1)
    near = np.einsum("ij,ij->i", axis.point - face.points, face.rays) < 0
    behind |= (residuals > _WIDTH) & near & (depth > np.linalg.norm(axis.point))
    gain = float(np.mean(plane - _cost(residuals)))
    return Support(contours, len(face.points), on, float(np.mean(behind)), gain)


def seen_lines(support: Support) -> tuple[Contours, Float32Array]:
    """Return which contours are seen and their lines in the images, in bit order.

    Returns:
        The bits, and (K, 4) float32 x1 y1 x2 y2, px: the straight line that is nearest to the
        contour in view, one row for each bit set.
    """
    bits = support.visible
    rows = [_nearest_line(contour.pieces) for contour in support.contours if contour.bit & bits]
    return bits, np.array(rows, np.float32).reshape(-1, 4)


def _nearest_line(pieces: Array) -> Array:
    """Return the straight line (4,) nearest to a broken one, (K, 4), as long as it."""
    ends = np.concatenate((pieces[0, :2], pieces[-1, 2:]))
    if len(pieces) == 1:
        return ends
    starts, ways = pieces[:, :2], pieces[:, 2:] - pieces[:, :2]
    shares = (np.arange(5) + 0.5) / 5.0
    points = (starts[:, None] + shares[:, None] * ways[:, None]).reshape(-1, 2)
    weights = np.repeat(np.linalg.norm(ways, axis=1), len(shares))
    # By the coordinate along which it runs, so that it ends where the contour leaves the picture.
    along = int(abs(ends[3] - ends[1]) > abs(ends[2] - ends[0]))
    slope, level = np.polyfit(points[:, along], points[:, 1 - along], 1, w=np.sqrt(weights))
    line = ends.copy()
    line[1 - along], line[3 - along] = slope * ends[along] + level, slope * ends[2 + along] + level
    return line
