"""The vehicle's way between two frames as their pictures show it: the surface seen again.

The thumbnails, an eighth of the images, are laid on each other by the depth of the surface points;
the displacement for which they agree best is the vehicle's, whatever the pose says.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
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
_BORDER = 3.0
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

    @property
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


def _aligned(
    before: Sight, now: Image, camera: Camera, change: Pose, start: Array
) -> tuple[Array, float] | None:
    """Climb to the translation for which the pictures agree best, robustly, by Gauss-Newton."""
    turned = change.rotate(before.points)
    way = start.copy()
    agreement = -1.0
    for blur in _BLURS:
        old = _sample(_even(before.thumbnail, blur), _small(before.pixels))
        picture = _even(now, blur)
        # Over 8 it is the change from pixel to pixel.
        slopes = [
            np.asarray(cv2.Sobel(picture, cv2.CV_32F, x, 1 - x, ksize=3, scale=0.125), np.float32)
            for x in (1, 0)
        ]
        for _ in range(_STEPS):
            points = turned + way
            places, seen = _places(points, camera, now)
            if int(seen.sum()) < _LEAST_POINTS:
                return None
            points, places = points[seen], places[seen]
            new = _sample(picture, places)
            off = new - old[seen]
            agreement = _alike(old[seen], new)
            across, down = (_sample(slope, places) for slope in slopes)
            u, v = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
            right = across * camera.fx / _SHRUNK / points[:, 2]
            below = down * camera.fy / _SHRUNK / points[:, 2]
            jacobian = np.stack((right, below, -(right * u + below * v)), axis=1)
            spread = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
            weights = 1.0 / (1.0 + np.square(off / (1.5 * spread)))
            weighted = jacobian * weights[:, None]
            # A little on the diagonal: a surface without any structure says nothing.
            normal = weighted.T @ jacobian + 1e-3 * np.eye(3)
            step = np.linalg.solve(normal, weighted.T @ off)
            way -= step
            if float(np.abs(step).max()) < _SETTLED:
                break
    return way, agreement


def _searched(
    before: Sight, now: Image, camera: Camera, change: Pose, level: Array
) -> Array | None:
    """Try level ways in any direction, about as far as the pose's way is long."""
    old = _sample(_even(before.thumbnail, _SEARCH_BLUR), _small(before.pixels))
    picture = _even(now, _SEARCH_BLUR)
    turned = change.rotate(before.points)
    reach = _SEARCH_REACH * float(np.linalg.norm(change.translation))
    sides = np.linspace(-reach, reach, _SEARCH_SIDE)
    best, found = 0.0, None
    for x in sides:
        for y in sides:
            way = x * level[0] + y * level[1]
            places, seen = _places(turned + way, camera, now)
            if int(seen.sum()) < _LEAST_POINTS:
                continue
            alike = _alike(old[seen], _sample(picture, places[seen]))
            if alike > best:
                best, found = alike, way
    return found


def _even(thumbnail: Image, blur: float) -> Float32Array:
    """Return the structure of a picture of about one size, whatever the light on it."""
    level = np.log(thumbnail.astype(np.float32) + np.float32(8.0))
    band = cv2.GaussianBlur(level, (0, 0), blur) - cv2.GaussianBlur(level, (0, 0), 3.0 * blur)
    power = cv2.GaussianBlur(band * band, (0, 0), 4.0 * blur)
    return np.asarray(band / (np.sqrt(power) + np.float32(0.01)), np.float32)


def _small(pixels: Array) -> Array:
    """Return where pixels of the image are in its thumbnail."""
    small: Array = (pixels + 0.5) / _SHRUNK - 0.5
    return small


def _places(points: Array, camera: Camera, picture: Image) -> tuple[Array, NDArray[np.bool_]]:
    """Return where points fall into a thumbnail, (N, 2), and which of them do, (N,)."""
    before = points[:, 2] > 0.1
    places = _small(camera.project(np.where(before[:, None], points, [0.0, 0.0, 1.0])))
    most = np.array([picture.shape[1], picture.shape[0]]) - 1.0 - _BORDER
    return places, before & ((places > _BORDER) & (places < most)).all(axis=1)


def _sample(picture: Float32Array, places: Array) -> Array:
    where = places.astype(np.float32)
    found = cv2.remap(picture, where[None, :, 0], where[None, :, 1], cv2.INTER_LINEAR)
    return np.asarray(found[0], np.float64)


def _alike(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else -1.0
