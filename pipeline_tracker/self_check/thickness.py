"""How thick the pipe is by its surface alone: a fit of a cylinder whose radius is not known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import BEND_SIGMA, Axis, across
from pipeline_tracker.evidence import distances_from_axis
from pipeline_tracker.face import on_face, point_sigmas, without_sag
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.surface import SurfacePoints

Array = NDArray[np.float64]

# Points on a face that tell its curvature, at least and at most.
_LEAST_POINTS, _MOST_POINTS = 60, 600
# Robust widths, in standard deviations: what is wrong by a tenth is many of them off.
_WIDTHS = (12.0, 12.0, 12.0, 5.0, 5.0, 5.0)
# Neighbouring points err alike: three of them count as two.
_POINT_WEIGHT = 0.65
# Radii beyond these shares of the given one are no matter of a wrong number.
_LEAST_SHARE, _MOST_SHARE = 0.5, 2.0


@dataclass(frozen=True)
class Thickness:
    """A cylinder fitted with its radius.

    Attributes:
        axis: left optical frame.
        radius: as the surface has it, m.
        sigma: its standard deviation, m.
    """

    axis: Axis
    radius: float
    sigma: float


def measure_thickness(
    surface: SurfacePoints, camera: Camera, start: Axis, radius: float, vertical: Array
) -> Thickness | None:
    """Fit axis, bend and radius to the points on a pipe's face.

    Stereo gives the depth of each point, and how it falls off to both sides tells the radius: one
    that is not ``pipe.diameter / 2`` means that the diameter or the baseline is wrong.

    Args:
        surface: triangulated matches.
        camera: the left one.
        start: rough axis, left optical frame, within about 10 cm and 3 degrees.
        radius: as it is given, m.
        vertical: unit vector up, left optical frame.

    Returns:
        The cylinder; None where too few points are seen or it went astray.
    """
    axis, size = start, radius
    loose = np.array([0.0, 0.0, 0.0, 0.0, BEND_SIGMA**-2, BEND_SIGMA**-2, 0.0])
    hessian = np.eye(7)
    for width in _WIDTHS:
        face = surface.subset(on_face(surface, camera, axis, size))
        if len(face.points) < _LEAST_POINTS:
            return None
        thin = -(-len(face.points) // _MOST_POINTS)
        face = face.subset(np.arange(len(face.points)) % thin == 0)
        face = without_sag(face, camera, axis, size)
        left, up = across(axis.direction, vertical)
        residuals, jacobian = _residuals(face, axis, size, left, up)
        weights = np.square(np.clip(1.0 - np.square(residuals / width), 0.0, None))
        weighted = _POINT_WEIGHT * jacobian * weights[:, None]
        hessian = weighted.T @ jacobian + np.diag(loose)
        known = np.array([0.0, 0.0, 0.0, 0.0, axis.bend @ left, axis.bend @ up, 0.0])
        try:
            step = -np.linalg.solve(hessian, weighted.T @ residuals + loose * known)
        except np.linalg.LinAlgError:
            return None
        turned = axis.direction + step[2] * left + step[3] * up
        axis = Axis(
            axis.point + step[0] * left + step[1] * up,
            turned / np.linalg.norm(turned),
            axis.bend + step[4] * left + step[5] * up,
        )
        size += float(step[6])
        # Written so that NaN is refused.
        if not (_LEAST_SHARE < size / radius < _MOST_SHARE and axis.point[2] > size):
            return None
    return Thickness(axis, size, float(np.sqrt(np.linalg.inv(hessian)[6, 6])))


def _residuals(
    face: SurfacePoints, axis: Axis, radius: float, left: Array, up: Array
) -> tuple[Array, Array]:
    """Return residuals (N,) in standard deviations, and their derivatives (N, 7) by what is fitted.

    Fitted are left and up in m, heading and pitch in rad, bend left and up in 1/m, radius in m.
    """
    sigmas = point_sigmas(face, axis)
    normals, distance = distances_from_axis(face.points, axis)
    t = (face.points - axis.point) @ axis.direction
    aside, above = -(normals @ left), -(normals @ up)
    bow = 0.5 * t**2
    columns = (aside, above, t * aside, t * above, bow * aside, bow * above, -np.ones_like(t))
    jacobian = np.stack(columns, axis=1)
    return (distance - radius) / sigmas, jacobian / sigmas[:, None]
