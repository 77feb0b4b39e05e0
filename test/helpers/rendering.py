"""Grey pictures of a straight pipe on a flat bed, by rays that meet both in closed form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from synthetic_world import World

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SMALL = StereoRig(
    Camera(380.0, 380.0, 239.5, 159.5, 480, 320),
    Camera(380.0, 380.0, 239.5, 159.5, 480, 320, offset=0.2),
)


def texture(points: Array, seed: int) -> Array:
    """Smooth random texture in space, mean 0: waves of 4 to 30 cm; points (N, 3), m."""
    random = np.random.default_rng(seed)
    total = np.zeros(len(points))
    for _ in range(14):
        direction = random.normal(size=3)
        length = 0.04 * 7.5 ** random.random()
        wave = 2.0 * math.pi / length * direction / np.linalg.norm(direction)
        total += np.cos(points @ wave + random.uniform(0.0, 2.0 * math.pi))
    return total / math.sqrt(7.0)


def picture(world: World, pose: Pose, mounting: Pose, camera: Camera, seed: int = 0) -> Image:
    """What a camera sees of a world without hump or bend.

    Args:
        world: odom.
        pose: odom <- base_link.
        mounting: base_link <- left optical frame.
        camera: the camera.
        seed: of its noise.
    """
    optical = pose @ mounting
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    rays = (
        np.stack(
            ((xs - camera.cx) / camera.fx, (ys - camera.cy) / camera.fy, np.ones_like(xs)), axis=-1
        ).reshape(-1, 3)
        @ optical.rotation.T
    )
    origin = optical.apply([camera.offset, 0.0, 0.0])
    far = (world.bed.level - origin[2]) / rays[:, 2]
    grey = 110.0 + 18.0 * texture(origin + far[:, None] * rays, 1)
    if world.pipe is not None:
        d = world.pipe.direction
        off = origin - world.pipe.point
        off = off - d * (off @ d)
        across = rays - np.outer(rays @ d, d)
        a = np.einsum("ij,ij->i", across, across)
        b = across @ off
        root = b * b - a * (off @ off - world.pipe.radius**2)
        near = (-b - np.sqrt(np.maximum(root, 0.0))) / a
        hit = (root > 0.0) & (near < far)
        places = origin + near[hit, None] * rays[hit]
        normal = across[hit] * near[hit, None] + off
        facing = np.abs(np.einsum("ij,ij->i", normal, rays[hit]))
        facing /= world.pipe.radius * np.linalg.norm(rays[hit], axis=1)
        # A lamp beside the camera: the pipe darkens towards its contours.
        grey[hit] = (150.0 + 22.0 * texture(places, 2)) * (0.45 + 0.55 * facing)
    grey += 1.5 * np.random.default_rng(seed).normal(size=grey.shape)
    image = np.clip(np.rint(grey), 0, 255).reshape(camera.height, camera.width)
    return np.asarray(image, np.uint8)


def pair(
    world: World, pose: Pose, mounting: Pose, rig: StereoRig = SMALL, seed: int = 0
) -> tuple[Image, Image | None]:
    """Left and right picture; None for the right one of a single camera."""
    images = [
        picture(world, pose, mounting, camera, 2 * seed + number)
        for number, camera in enumerate(rig.cameras)
    ]
    return images[0], images[1] if len(images) > 1 else None
