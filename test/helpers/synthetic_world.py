"""A pipe on a bed, seen by a stereo rig: vectorized frames built directly from geometry.

Rays are marched to the surfaces and outlines are found section by section; of the tracker's own
geometry only poses and cameras are used, as containers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.types import PipeSegment, VectorizedStereo

Array = NDArray[np.float64]

SECOND = 1_000_000_000
LEFT = Camera(930.0, 930.0, 599.5, 399.5, 1200, 800)
RIG = StereoRig(LEFT, Camera(930.0, 930.0, 599.5, 399.5, 1200, 800, offset=0.2))
MONO = StereoRig(LEFT, None)
# Left optical frame in base_link: straight down, top of the picture forward; and 30 degrees on.
DOWN = Pose.from_rpy([0.3, 0.1, -0.2], [math.pi, 0.0, -math.pi / 2.0])
TILTED = Pose.from_rpy([0.3, 0.1, -0.2], [-2.618, 0.0, -1.571])


@dataclass(frozen=True)
class Pipe:
    """A pipe in odom whose axis is a straight line or an arc.

    Attributes:
        point: a point of the axis, (3,), m.
        heading, slope: direction of the axis there, rad; a positive slope climbs.
        radius: m.
        curvature: of the axis to its left, 1/m.
    """

    point: Array
    heading: float = 0.0
    slope: float = 0.0
    radius: float = 0.3
    curvature: float = 0.0

    @property
    def direction(self) -> Array:
        flat = math.cos(self.slope)
        return np.array(
            [
                math.cos(self.heading) * flat,
                math.sin(self.heading) * flat,
                math.sin(self.slope),
            ]
        )

    @property
    def left(self) -> Array:
        return np.array([-math.sin(self.heading), math.cos(self.heading), 0.0])

    def axis(self, s: Array) -> tuple[Array, Array]:
        """Points and unit tangents of the axis at ways ``s`` (N,) from its point."""
        k = self.curvature
        s = np.asarray(s, np.float64)[:, None]
        if k == 0.0:
            return self.point + s * self.direction, np.broadcast_to(self.direction, (len(s), 3))
        ahead, aside = np.sin(k * s) / k, (1.0 - np.cos(k * s)) / k
        points = self.point + ahead * self.direction + aside * self.left
        return points, np.cos(k * s) * self.direction + np.sin(k * s) * self.left

    def from_axis(self, points: Array) -> Array:
        """Distance of points (N, 3) from the axis, (N,), m."""
        off = points - self.point
        if self.curvature == 0.0:
            return np.asarray(np.linalg.norm(np.cross(off, self.direction), axis=1))
        centre = self.left / self.curvature
        normal = np.cross(self.direction, self.left)
        off = off - centre
        height = off @ normal
        flat = np.linalg.norm(off - height[:, None] * normal, axis=1)
        return np.asarray(np.hypot(flat - 1.0 / abs(self.curvature), height))


@dataclass(frozen=True)
class Bed:
    """A plane at a height, with a long hump on it if its height is not 0.

    Attributes:
        level: z of the plane, m.
        hump: height of the hump, m.
        width: standard deviation of the hump's bell-shaped section, m.
        heading: of the hump's crest, which passes the origin, rad.
    """

    level: float
    hump: float = 0.0
    width: float = 0.3
    heading: float = 0.0

    def above(self, points: Array) -> Array:
        """Height of points (N, 3) above the bed, (N,), m."""
        across = points[:, 1] * math.cos(self.heading) - points[:, 0] * math.sin(self.heading)
        rise = self.hump * np.exp(-0.5 * np.square(across / self.width))
        return np.asarray(points[:, 2] - self.level - rise)


@dataclass(frozen=True)
class World:
    """A bed, and a pipe or none."""

    bed: Bed
    pipe: Pipe | None = None

    @classmethod
    def with_pipe(
        cls,
        height: float = 2.0,
        aside: float = 0.0,
        heading: float = 0.0,
        slope: float = 0.0,
        radius: float = 0.3,
        curvature: float = 0.0,
        ahead: float = 0.0,
    ) -> World:
        """A pipe that rests on a flat bed; its axis passes (ahead, aside, -height) in odom."""
        point = np.array([ahead, aside, -height])
        return cls(Bed(-height - radius), Pipe(point, heading, slope, radius, curvature))

    def clearance(self, points: Array) -> Array:
        """No less than the distance to the nearest surface for steps along a ray, (N,), m."""
        free = 0.7 * self.bed.above(points)
        if self.pipe is not None:
            free = np.minimum(free, self.pipe.from_axis(points) - self.pipe.radius)
        return free

    def hit(self, origin: Array, rays: Array) -> Array:
        """Distances (N,) at which unit rays (N, 3) meet a surface; NaN where they meet none."""
        far = np.zeros(len(rays))
        for _ in range(400):
            step = self.clearance(origin + far[:, None] * rays)
            far = np.minimum(far + step, 50.0)
            if float(np.max(np.abs(step[far < 50.0]), initial=0.0)) < 1e-6:
                break
        return np.where(far < 49.0, far, np.nan)


@dataclass(frozen=True)
class Look:
    """How well a frame is seen.

    Attributes:
        pixel_noise: standard deviation of a segment's ends across it, px.
        disparity_noise: px.
        outliers: share of matches that are anything.
        clutter: segments of the bed in each image.
        seen: share of each contour that gives segments: left and right, as seen along the
            pipe's own direction, in the left image and in the right one.
        spacing: of the grid of matches, px.
        texture: whether there are matches at all.
    """

    pixel_noise: float = 0.4
    disparity_noise: float = 0.1
    outliers: float = 0.05
    clutter: int = 80
    seen: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 0.8)
    spacing: int = 32
    texture: bool = True


GOOD = Look()
EXACT = Look(pixel_noise=0.0, disparity_noise=0.0, outliers=0.0, clutter=0)


@dataclass(frozen=True)
class Diver:
    """A vehicle with a rig: makes the frames that it would see.

    Attributes:
        world: what it swims over.
        rig: its cameras.
        mounting: base_link <- left optical frame.
        look: how well it sees.
    """

    world: World
    rig: StereoRig = RIG
    mounting: Pose = DOWN
    look: Look = field(default_factory=Look)

    def frame(self, pose: Pose, stamp_ns: int = 0, seed: int = 0) -> VectorizedStereo:
        """The vectorized frame at a pose odom <- base_link."""
        random = np.random.default_rng(seed)
        optical = pose @ self.mounting
        images = []
        for number, camera in enumerate(self.rig.cameras):
            parts = self._contours(optical, camera, self.look.seen[2 * number :][:2], random)
            parts.append(_clutter(self.look.clutter, camera, random))
            found = np.concatenate(parts).astype(np.float32)
            images.append(found[random.permutation(len(found))])
        mono = self.rig.right is None
        none = np.zeros((0, 4), np.float32)
        grey = np.full((self.rig.left.height // 8, self.rig.left.width // 8), 120, np.uint8)
        return VectorizedStereo(
            stamp_ns=stamp_ns,
            rig=self.rig,
            left_segments=images[0],
            right_segments=none if mono else images[1],
            matches=none if mono or not self.look.texture else self._matches(optical, random),
            left_thumbnail=grey,
            right_thumbnail=grey[:0, :0] if mono else grey,
        )

    def _contours(
        self, optical: Pose, camera: Camera, seen: tuple[float, ...], random: np.random.Generator
    ) -> list[Array]:
        """Segments along both true outlines of the pipe in one image."""
        pipe = self.world.pipe
        if pipe is None:
            return []
        centre = optical.translation + optical.rotation @ [camera.offset, 0.0, 0.0]
        near = float((centre - pipe.point) @ pipe.direction)
        middles, tangents = pipe.axis(near + np.linspace(-8.0, 8.0, 3201))
        first = np.cross(tangents, [0.0, 0.0, 1.0])
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(tangents, first)
        # A surface point is on the outline where its normal is square to the ray: on each section
        # a cosine of the angle round it that must have one value.
        away = middles - centre
        a, b = np.einsum("ij,ij->i", away, first), np.einsum("ij,ij->i", away, second)
        turn = np.arccos(np.clip(-pipe.radius / np.hypot(a, b), -1.0, 1.0))
        # Right is where travel x (towards the camera) points.
        rightward = np.cross(tangents, -away)
        parts = []
        for sign in (1.0, -1.0):
            angle = (np.arctan2(b, a) + sign * turn)[:, None]
            ring = middles + pipe.radius * (np.cos(angle) * first + np.sin(angle) * second)
            local = (ring - optical.translation) @ optical.rotation
            ok = (local[:, 2] > 0.1) & (self.world.bed.above(ring) > 0.0)
            pixels = np.full((len(ring), 2), -1e9)
            pixels[ok] = _project(local[ok], camera)
            ok &= (pixels > -0.5).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
            right = float(np.einsum("ij,ij->", ring - middles, rightward)) > 0.0
            parts.append(_chop(pixels[ok], seen[int(right)], self.look.pixel_noise, random))
        return parts

    def _matches(self, optical: Pose, random: np.random.Generator) -> NDArray[np.float32]:
        left, right = self.rig.cameras
        xs = np.arange(self.look.spacing // 2, left.width, self.look.spacing)
        ys = np.arange(self.look.spacing // 2, left.height, self.look.spacing)
        pixels = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2).astype(np.float64)
        rays = np.column_stack(
            ((pixels - [left.cx, left.cy]) / [left.fx, left.fy], np.ones(len(pixels)))
        )
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        far = self.world.hit(optical.translation, rays @ optical.rotation.T)
        pixels, rays, far = pixels[far > 0], rays[far > 0], far[far > 0]
        points = rays * far[:, None]
        # Seen by the right camera too, if its own ray ends at the same place.
        from_right = points - [right.offset, 0.0, 0.0]
        length = np.linalg.norm(from_right, axis=1)
        centre = optical.apply([right.offset, 0.0, 0.0])
        there = self.world.hit(centre, (from_right / length[:, None]) @ optical.rotation.T)
        other = _project(points, right)
        both = (np.abs(there - length) < 0.005) & (other[:, 0] > 0) & (other[:, 0] < right.width)
        pixels, x = pixels[both], other[both, 0]
        x = x + random.normal(0.0, 1.0, len(x)) * self.look.disparity_noise
        wrong = random.random(len(x)) < self.look.outliers
        x = np.where(wrong, pixels[:, 0] - random.uniform(5.0, 280.0, len(x)), x)
        return np.column_stack((pixels, x, pixels[:, 1])).astype(np.float32)

    def errors(self, segment: PipeSegment, pose: Pose) -> tuple[float, float]:
        """Largest distance of a segment's ends from the true axis, m, and their turn from it."""
        assert self.world.pipe is not None
        ends = pose.apply(np.stack((segment.start, segment.end)))
        along = ends[1] - ends[0]
        along /= np.linalg.norm(along)
        s = np.linspace(-30.0, 30.0, 60_001)
        points, tangents = self.world.pipe.axis(s)
        nearest = int(np.argmin(np.linalg.norm(points - ends.mean(axis=0), axis=1)))
        turn = float(np.arccos(np.clip(along @ tangents[nearest], -1.0, 1.0)))
        return float(np.max(self.world.pipe.from_axis(ends))), turn


def _project(points: Array, camera: Camera) -> Array:
    x = camera.cx + camera.fx * (points[:, 0] - camera.offset) / points[:, 2]
    return np.column_stack((x, camera.cy + camera.fy * points[:, 1] / points[:, 2]))


def _chop(pixels: Array, share: float, noise: float, random: np.random.Generator) -> Array:
    """Cut a curve of the image into segments with gaps between them, both ways round."""
    if len(pixels) < 2:
        return np.zeros((0, 4))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(pixels, axis=0).T))))
    rows = []
    place = 0.0
    while place < way[-1] - 15.0:
        length = min(random.uniform(25.0, 110.0), way[-1] - place)
        if random.random() < share:
            ends = np.array([place, place + length])
            x, y = np.interp(ends, way, pixels[:, 0]), np.interp(ends, way, pixels[:, 1])
            normal = np.array([-(y[1] - y[0]), x[1] - x[0]]) / np.hypot(x[1] - x[0], y[1] - y[0])
            off = random.normal(0.0, 1.0, 2) * noise
            row = np.column_stack((x + off * normal[0], y + off * normal[1]))
            rows.append((row if random.random() < 0.5 else row[::-1]).ravel())
        place += length
    return np.array(rows).reshape(-1, 4)


def _clutter(count: int, camera: Camera, random: np.random.Generator) -> Array:
    middle = random.uniform(0.0, 1.0, (count, 2)) * [camera.width - 1, camera.height - 1]
    angle = random.uniform(0.0, np.pi, count)
    half = 0.5 * random.uniform(12.0, 45.0, count)
    step = np.column_stack((half * np.cos(angle), half * np.sin(angle)))
    return np.column_stack((middle - step, middle + step))


def level_pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Pose:
    """Pose odom <- base_link of a vehicle on an even keel."""
    return Pose.from_rpy([x, y, z], [0.0, 0.0, yaw])
