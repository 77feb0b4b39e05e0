"""Outlines of a straight cylinder, found by looking at a dense sample of its surface.

Nothing here knows of tangent points: of all generatrices of the cylinder those two are taken which
a camera sees furthest to either side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera

Array = NDArray[np.float64]

_ROUND = 20_000


@dataclass(frozen=True)
class Cylinder:
    """A straight cylinder in the left optical frame.

    Attributes:
        point: a point of the axis, (3,), m.
        direction: unit direction of the axis, (3,), along travel.
        radius: m.
    """

    point: Array
    direction: Array
    radius: float

    @classmethod
    def seen(
        cls, pixel: Array, depth: float, heading: float, tilt: float, radius: float, camera: Camera
    ) -> Cylinder:
        """Make a cylinder whose axis passes a pixel at a depth.

        Args:
            pixel: (2,), px.
            depth: z of the axis there, m.
            heading: direction in the image plane, from the columns' axis x towards y, rad.
            tilt: of the axis out of the image plane, away from the camera, rad.
            radius: m.
            camera: the camera.
        """
        x = (pixel[0] - camera.cx) / camera.fx * depth
        y = (pixel[1] - camera.cy) / camera.fy * depth
        direction = np.array(
            [np.cos(heading) * np.cos(tilt), np.sin(heading) * np.cos(tilt), np.sin(tilt)]
        )
        return cls(np.array([x, y, depth]), direction, radius)

    def distance(self, point: Array) -> float:
        """Distance of a point from the axis, m."""
        off = point - self.point
        return float(np.linalg.norm(off - self.direction * (off @ self.direction)))


def pixels_of(points: Array, camera: Camera) -> Array:
    """Project points (N, 3) of the left optical frame to pixels (N, 2)."""
    homogeneous = (points - [camera.offset, 0.0, 0.0]) @ np.array(
        [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    ).T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def outlines(cylinder: Cylinder, camera: Camera) -> tuple[Array, Array]:
    """Points of the left and of the right outline as a camera sees them.

    Returns:
        Two arrays (2, 3): two points before the camera on each of the two outermost generatrices,
        the left one first, as seen along the cylinder's direction with the camera above.
    """
    d = cylinder.direction
    centre = np.array([camera.offset, 0.0, 0.0])
    to_camera = centre - cylinder.point
    to_camera = to_camera - d * (to_camera @ d)
    near = to_camera / np.linalg.norm(to_camera)
    side = np.cross(d, near)
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)[:, None]
    ring = cylinder.point + cylinder.radius * (np.cos(angle) * near + np.sin(angle) * side)
    # How far to the side each generatrix is seen, as an angle about the camera's centre.
    rays = ring - centre
    seen = np.arctan2(rays @ side, -(rays @ near))
    found = []
    for index in (int(np.argmin(seen)), int(np.argmax(seen))):
        start = ring[index]
        ends = start + d * np.linspace(-3.0, 3.0, 61)[:, None]
        ends = ends[ends[:, 2] > 0.3]
        found.append(ends[[0, -1]])
    return found[0], found[1]


def outline_lines(cylinder: Cylinder, camera: Camera) -> tuple[Array, Array]:
    """Left and right outline in the image as homogeneous lines (a, b, c), a² + b² = 1, px."""
    lines = []
    for ends in outlines(cylinder, camera):
        (x1, y1), (x2, y2) = pixels_of(ends, camera)
        normal = np.array([y2 - y1, x1 - x2]) / np.hypot(x2 - x1, y2 - y1)
        lines.append(np.array([*normal, -(normal @ [x1, y1])]))
    return lines[0], lines[1]
