"""How well a pair of pictures bears an axis: its surface, its contours, and the bed beside it.

A number of this module is a share of what was to be expected, so that frames can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis
from pipeline_tracker.evidence import REFERENCE_WIDTH, rays_to_axis
from pipeline_tracker.face import distance_sigma, on_face, without_sag
from pipeline_tracker.geometry.bent_axis import nearest_to_points, place_and_tangent
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import NEAR, boundary_in_view, clip_to_view
from pipeline_tracker.jit import compiled
from pipeline_tracker.plane import WIDTH, plane_cost, robust_cost
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
# A bent axis is cut into so many pieces; a bend below this, 1/m, is none.
_PIECES, _STRAIGHT = 8, 1e-9
# A surface at another scale than the contours: shares of its points on the pipe before and after
# it is scaled, its gain, the scales looked at, and the least share of each contour.
_OTHER_SCALE_SHARE, _OTHER_SCALE_GAIN = 0.3, -0.1
_SCALES = (0.65, 1.55)
_CLEAR_SHARE = 0.35

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


@compiled
def _contour_pieces(
    axis: Array, radius: float, camera: Array, pieces: Array, counts: NDArray[np.int64]
) -> None:
    """Project the two visible boundaries of a bent axis, piece by piece (4.1.2).

    Args:
        axis, camera: rows and numbers.
        radius: m.
        pieces: (2, K, 4), filled for the left and for the right contour as ``contour_pieces``
            returns them.
        counts: (2,), filled with how many they are.
    """
    counts[:] = 0
    margin = -_BORDER * camera[4]
    # Towards the vanishing point the pipe is a point; there is no need to go there.
    reach = REACH * max(1.0, axis[0, 2])
    low, high = clip_to_view(axis[0], axis[1], camera, NEAR, margin, -np.inf, np.inf)
    low, high = max(low, -reach), min(high, reach)
    if not low < high:
        return
    bend = np.sqrt(axis[2, 0] ** 2 + axis[2, 1] ** 2 + axis[2, 2] ** 2)
    knots = 1 if bend < _STRAIGHT else _PIECES
    half = 0.5 * (high - low) / knots
    for k in range(knots):
        x, y, z, dx, dy, dz = place_and_tangent(axis, low + (2 * k + 1) * half)
        point, direction = np.array([x, y, z]), np.array([dx, dy, dz])
        for side in range(2):
            line = pieces[side, counts[side]]
            if boundary_in_view(
                point, direction, radius, 2.0 * side - 1.0, camera, -half, half, line
            ):
                counts[side] += 1


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
    pieces, counts = np.empty((2, _PIECES, 4)), np.empty(2, np.int64)
    _contour_pieces(axis.rows, radius, camera.numbers, pieces, counts)
    return [pieces[side, : counts[side]] for side in (0, 1)]


@compiled
def _line_supports(
    segments: Float32Array, lines: Array, distance: float, angle: float, scratch: Array
) -> tuple[float, float]:
    """Sum what ``line_support`` returns over the lines, (K, 4), of a broken one."""
    total = 0.0
    length = 0.0
    if lines.shape[0] > 1:
        segments = _near_broken_line(segments, lines, distance, angle)
    for k in range(lines.shape[0]):
        part, own = line_support(segments, lines[k], distance, angle, scratch)
        total += part
        length += own
    return total, length


@compiled
def _near_broken_line(
    segments: Float32Array, lines: Array, distance: float, angle: float
) -> Float32Array:
    """Return the segments that may support a line of a broken one, and some others.

    Most are far from all of its lines: that is asked once, of the straight line from its begin to
    its end, and not of each.
    """
    x0, y0 = lines[0, 0], lines[0, 1]
    ux, uy = lines[-1, 2] - x0, lines[-1, 3] - y0
    chord = np.sqrt(ux * ux + uy * uy)
    if not chord > 0.0:
        return segments
    ux, uy = ux / chord, uy / chord
    # How far the broken line is from the chord, and the sine of the steepest angle between them.
    bow = 0.0
    turn = 0.0
    for k in range(lines.shape[0]):
        dx, dy = lines[k, 2] - lines[k, 0], lines[k, 3] - lines[k, 1]
        bow = max(bow, abs((lines[k, 0] - x0) * uy - (lines[k, 1] - y0) * ux))
        turn = max(turn, abs(dx * uy - dy * ux) / max(np.sqrt(dx * dx + dy * dy), 1e-9))
    steepest = np.sin(angle) + turn
    near = np.empty(segments.shape, np.float32)
    count = 0
    for i in range(segments.shape[0]):
        sx, sy = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
        own = np.sqrt(sx * sx + sy * sy)
        off = 0.5 * (segments[i, 0] + segments[i, 2]) - x0
        off = abs(off * uy - (0.5 * (segments[i, 1] + segments[i, 3]) - y0) * ux)
        # A segment's middle may lie beyond the end of the line that it supports.
        reach = distance + bow + 0.5 * turn * own + 1.0
        if off <= reach and abs(sx * uy - sy * ux) <= (steepest + 1e-3) * own:
            near[count] = segments[i]
            count += 1
    return near[:count]


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
        seen = np.ascontiguousarray(segments[number], np.float32)
        for side in (0, 1):
            total, length = _line_supports(seen, pieces[side], scaled, angle, scratch)
            if length > 0:
                bit = BITS[number][side]
                found.append(ContourSupport(bit, pieces[side], total, length))
    return tuple(found)


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
    plane = plane_cost(face.points, face.depth_sigmas, face.rays)
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
    on, behind, gain = _face_shares(
        face.points, face.rays, face.depth_sigmas, axis.rows, radius, plane
    )
    return Support(contours, len(face.points), on, behind, gain)


@compiled
def _face_shares(
    points: Array, rays: Array, depth_sigmas: Array, axis: Array, radius: float, plane: Array
) -> tuple[float, float, float]:
    """Return shares on the pipe and behind its face, and the gain over a plane, see ``Support``.

    Args:
        points, rays, depth_sigmas: of the face, N >= 1.
        axis: rows of the axis.
        radius: m.
        plane: cost of each point for a plane, (N,).
    """
    on = 0
    behind = 0
    gain = 0.0
    far = axis[0, 0] ** 2 + axis[0, 1] ** 2 + axis[0, 2] ** 2
    n = points.shape[0]
    nearest = np.empty((5, n))
    nearest_to_points(axis, np.ascontiguousarray(points.T), nearest)
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        distance, vx, vy, vz = nearest[0, i], nearest[1, i], nearest[2, i], nearest[3, i]
        facing = (vx * rays[i, 0] + vy * rays[i, 1] + vz * rays[i, 2]) / max(distance, 1e-9)
        residual = (distance - radius) / distance_sigma(depth_sigmas[i], facing)
        gain += plane[i] - robust_cost(residual)
        if abs(residual) < WIDTH:
            on += 1
        # What lies behind the face, inside the pipe or seen through it.
        elif residual < 0.0:
            behind += 1
        else:
            past = 0.0
            for k in range(3):
                past += (axis[0, k] - points[i, k]) * rays[i, k]
            behind += past < 0.0 and x * x + y * y + z * z > far
    return on / n, behind / n, gain / n


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
    line = np.concatenate((pieces[0, :2], pieces[-1, 2:]))
    if len(pieces) > 1:
        _straighten(pieces, line)
    return line


@compiled
def _straighten(pieces: Array, line: Array) -> None:
    """Move the ends of a line, (4,), to the least squares of pieces, (K, 4), by their length."""
    # By the coordinate along which it runs, so that it ends where the contour leaves the picture.
    along = 1 if abs(line[3] - line[1]) > abs(line[2] - line[0]) else 0
    total = 0.0
    sx = sy = sxx = sxy = 0.0
    for k in range(pieces.shape[0]):
        x0, y0 = pieces[k, along] - line[along], pieces[k, 1 - along]
        dx, dy = (
            pieces[k, 2 + along] - pieces[k, along],
            pieces[k, 3 - along] - pieces[k, 1 - along],
        )
        w = np.sqrt(dx * dx + dy * dy)
        for j in range(5):
            x, y = x0 + 0.1 * (2 * j + 1) * dx, y0 + 0.1 * (2 * j + 1) * dy
            total += w
            sx += w * x
            sy += w * y
            sxx += w * x * x
            sxy += w * x * y
    slope = (total * sxy - sx * sy) / (total * sxx - sx * sx)
    level = (sy - slope * sx) / total
    line[1 - along] = level
    line[3 - along] = level + slope * (line[2 + along] - line[along])
