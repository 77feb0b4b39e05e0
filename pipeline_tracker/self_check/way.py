"""The vehicle's way between two frames as their pictures show it: the surface seen again.

The thumbnails, an eighth of the images, are laid on each other by the depth of the surface points;
the displacement for which they agree best is the vehicle's, whatever the pose says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.jit import compiled
from pipeline_tracker.surface import SurfacePoints
from pipeline_tracker.types import Float32Array, Image

Array = NDArray[np.float64]

_SHRUNK = 8.0
# Points that are laid on each other, at most and at least.
_MOST_POINTS, _LEAST_POINTS = 500, 80
# Blur of the thumbnails, px of them: from coarse to fine.
_BLURS = (2.5, 1.2)
_STEPS = 6
_SETTLED = 3e-4
_BORDER, _NEAREST = 3.0, 0.1
# Where the pose leads to nothing alike, all level ways are tried with more blur: up to this many
# times its length forward, back and to both sides, and so many in each.
_SEARCH_BLUR, _SEARCH_REACH, _SEARCH_SIDE = 4.0, 1.2, 15
LEAST_AGREEMENT = 0.75


@dataclass(frozen=True)
class Sight:
    """What of a frame is seen again in a later one.

    Attributes:
        points: surface points, (N, 3), left optical frame, m.
        pixels: their pixels in the left image, (N, 2), px.
        thumbnail: of the left image.
        pose: odom <- base_link.
    """

    points: Array
    pixels: Array
    thumbnail: Image
    pose: Pose

    @cached_property
    def distance(self) -> float:
        """How far away the surface is, the median, m."""
        return float(np.median(self.points[:, 2]))


def sight(surface: SurfacePoints, thumbnail: Image, pose: Pose) -> Sight | None:
    """Return what of a frame can be seen again; None where it is too little."""
    if len(surface.points) < _LEAST_POINTS or thumbnail.size == 0:
        return None
    step = -(-len(surface.points) // _MOST_POINTS)
    return Sight(surface.points[::step], surface.left_pixels[::step], thumbnail, pose)


def seen_way(
    before: Sight, now: Image, camera: Camera, change: Pose, level: Array
) -> tuple[Array, float] | None:
    """Measure the displacement between two frames; the rotation is taken from the pose.

    Args:
        before: the frame before.
        now: thumbnail of the left image.
        camera: the left camera.
        change: left optical frame now <- before, as the pose has it.
        level: the vehicle's x and y axes, (2, 3), left optical frame.

    Returns:
        The translation of that change by the pictures, (3,), m, and how well they agree, -1 to 1;
        None where too little of the one is seen in the other.
    """
    found = _aligned(before, now, camera, change, change.translation)
    if found is not None and found[1] >= LEAST_AGREEMENT:
        return found
    start = _searched(before, now, camera, change, level)
    again = None if start is None else _aligned(before, now, camera, change, start)
    if again is None or (found is not None and found[1] >= again[1]):
        return found
    return again


def warm_up() -> None:
    """Compile or load what is compiled here."""
    random = np.random.default_rng(0)
    camera = Camera(200.0, 200.0, 159.5, 119.5, 320, 240)
    pixels = random.uniform(40.0, 200.0, (2 * _LEAST_POINTS, 2))
    # Two pictures that have nothing in common: all is tried.
    before, now = random.integers(0, 255, (2, 30, 40)).astype(np.uint8)
    seen = Sight(2.0 * camera.rays(pixels), pixels, before, Pose.identity())
    change = Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))
    seen_way(seen, now, camera, change, np.eye(3)[:2])


def _aligned(
    before: Sight, now: Image, camera: Camera, change: Pose, start: Array
) -> tuple[Array, float] | None:
    """Climb to the translation for which the pictures agree best, robustly, by Gauss-Newton."""
    turned = change.rotate(before.points)
    way = start.copy()
    agreement = -1.0
    for blur in _BLURS:
        old = _sampled(_even(before.thumbnail, blur), _small(before.pixels))
        picture = _even(now, blur)
        # Over 8 it is the change from pixel to pixel.
        across, down = (
            np.asarray(cv2.Sobel(picture, cv2.CV_32F, x, 1 - x, ksize=3, scale=0.125), np.float32)
            for x in (1, 0)
        )
        agreement = _climb(turned, old, picture, across, down, camera.numbers, way)
        if np.isnan(agreement):
            return None
    return way, agreement


def _searched(
    before: Sight, now: Image, camera: Camera, change: Pose, level: Array
) -> Array | None:
    """Try level ways in any direction, about as far as the pose's way is long."""
    old = _sampled(_even(before.thumbnail, _SEARCH_BLUR), _small(before.pixels))
    picture = _even(now, _SEARCH_BLUR)
    turned = change.rotate(before.points)
    reach = _SEARCH_REACH * float(np.linalg.norm(change.translation))
    sides = np.linspace(-reach, reach, _SEARCH_SIDE)
    way = np.empty(3)
    found = _search(turned, old, picture, camera.numbers, level, sides, way)
    return way if found else None


@compiled
def _climb(
    turned: Array,
    old: Array,
    picture: Float32Array,
    across: Float32Array,
    down: Float32Array,
    camera: Array,
    way: Array,
) -> float:
    """Move a way to where the pictures agree best, see ``_aligned``.

    Args:
        turned: the points, in the axes of the camera now, (N, 3), m.
        old: what the picture before shows of each, (N,).
        picture, across, down: the picture now and its slopes.
        camera: its numbers.
        way: (3,), m, moved.

    Returns:
        How well they agree before the last step, -1 to 1; NaN where too little is seen again.
    """
    n = turned.shape[0]
    new, was, off = np.empty(n), np.empty(n), np.empty(n)
    jacobian = np.empty((n, 3))
    agreement = -1.0
    for _ in range(_STEPS):
        count = 0
        for i in range(n):
            x, y, z = turned[i, 0] + way[0], turned[i, 1] + way[1], turned[i, 2] + way[2]
            column, row = _place(x, y, z, camera)
            if not _inside(column, row, picture):
                continue
            new[count], was[count] = _bilinear(picture, column, row), old[i]
            off[count] = new[count] - old[i]
            right = _bilinear(across, column, row) * camera[0] / _SHRUNK / z
            below = _bilinear(down, column, row) * camera[1] / _SHRUNK / z
            jacobian[count, 0], jacobian[count, 1] = right, below
            jacobian[count, 2] = -(right * x + below * y) / z
            count += 1
        if count < _LEAST_POINTS:
            return np.nan
        agreement = _alike(was[:count], new[:count])
        spread = max(1.4826 * np.median(np.abs(off[:count])), 1e-3)
        # A little on the diagonal: a surface without any structure says nothing.
        normal, gradient = 1e-3 * np.eye(3), np.zeros(3)
        for i in range(count):
            ratio = off[i] / (1.5 * spread)
            weight = 1.0 / (1.0 + ratio * ratio)
            for a in range(3):
                gradient[a] += weight * jacobian[i, a] * off[i]
                for b in range(3):
                    normal[a, b] += weight * jacobian[i, a] * jacobian[i, b]
        step = np.linalg.solve(normal, gradient)
        way -= step
        if np.max(np.abs(step)) < _SETTLED:
            break
    return agreement


@compiled
def _search(
    turned: Array,
    old: Array,
    picture: Float32Array,
    camera: Array,
    level: Array,
    sides: Array,
    way: Array,
) -> bool:
    """Fill the way, (3,), m, for which the pictures agree best; whether they do anywhere.

    Args:
        turned, old, picture, camera: see ``_climb``.
        level: the vehicle's x and y axes, (2, 3).
        sides: lengths that are tried along each, m.
        way: filled.
    """
    new, was = np.empty(turned.shape[0]), np.empty(turned.shape[0])
    best = 0.0
    tried = np.empty(3)
    for along in sides:
        for aside in sides:
            for c in range(3):
                tried[c] = along * level[0, c] + aside * level[1, c]
            count = 0
            for i in range(turned.shape[0]):
                z = turned[i, 2] + tried[2]
                column, row = _place(turned[i, 0] + tried[0], turned[i, 1] + tried[1], z, camera)
                if _inside(column, row, picture):
                    new[count], was[count] = _bilinear(picture, column, row), old[i]
                    count += 1
            if count < _LEAST_POINTS:
                continue
            alike = _alike(was[:count], new[:count])
            if alike > best:
                best = alike
                way[:] = tried
    return best > 0.0


def _even(thumbnail: Image, blur: float) -> Float32Array:
    """Return the structure of a picture of about one size, whatever the light on it."""
    level = np.log(thumbnail.astype(np.float32) + np.float32(8.0))
    band = cv2.GaussianBlur(level, (0, 0), blur) - _smooth(level, 3.0 * blur)
    power = _smooth(band * band, 4.0 * blur)
    return np.asarray(band / (np.sqrt(power) + np.float32(0.01)), np.float32)


def _smooth(picture: Float32Array, blur: float) -> Float32Array:
    """Blur a picture much, by two means over squares: cheap, however large they are."""
    side = 2 * round(0.5 * (np.sqrt(6.0 * blur**2 + 1.0) - 1.0)) + 1
    for _ in range(2):
        picture = np.asarray(cv2.blur(picture, (side, side)), np.float32)
    return picture


def _small(pixels: Array) -> Array:
    """Return where pixels of the image are in its thumbnail."""
    small: Array = (pixels + 0.5) / _SHRUNK - 0.5
    return small


@compiled
def _place(x: float, y: float, z: float, camera: Array) -> tuple[float, float]:
    """Return column and row of a point in the thumbnail; NaN where it is not before the camera."""
    if not z > _NEAREST:
        return np.nan, np.nan
    column = camera[0] * x / z + camera[2]
    row = camera[1] * y / z + camera[3]
    return (column + 0.5) / _SHRUNK - 0.5, (row + 0.5) / _SHRUNK - 0.5


@compiled
def _inside(column: float, row: float, picture: Float32Array) -> bool:
    """Tell whether a place is within a picture, off its borders."""
    height, width = picture.shape
    wide = _BORDER < column < width - 1.0 - _BORDER
    return bool(wide and _BORDER < row < height - 1.0 - _BORDER)


@compiled
def _bilinear(picture: Float32Array, column: float, row: float) -> float:
    x, y = int(column), int(row)
    u, v = column - x, row - y
    above = (1.0 - u) * picture[y, x] + u * picture[y, x + 1]
    below = (1.0 - u) * picture[y + 1, x] + u * picture[y + 1, x + 1]
    return float((1.0 - v) * above + v * below)


def _sampled(picture: Float32Array, places: Array) -> Array:
    """Return what a picture shows at places (N, 2), (N,)."""
    where = places.astype(np.float32)
    found = cv2.remap(picture, where[None, :, 0], where[None, :, 1], cv2.INTER_LINEAR)
    return np.asarray(found[0], np.float64)


@compiled
def _alike(a: Array, b: Array) -> float:
    """Return the correlation of two rows of numbers, (N,); -1 where one is all the same."""
    mean_a, mean_b = np.mean(a), np.mean(b)
    aa, bb, ab = 0.0, 0.0, 0.0
    for i in range(a.shape[0]):
        aa += (a[i] - mean_a) ** 2
        bb += (b[i] - mean_b) ** 2
        ab += (a[i] - mean_a) * (b[i] - mean_b)
    size = np.sqrt(aa * bb)
    return float(ab) / size if size > 0.0 else -1.0
