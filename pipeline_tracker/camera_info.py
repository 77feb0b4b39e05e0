"""A camera's calibration as sensor_msgs/CameraInfo has it, in either world of messages.

CameraInfo describes the whole sensor. An image may be a part of it (``roi``), and may have been
made smaller by averaging (``binning_x``, ``binning_y``): K and P are taken to the image as it
comes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import CalibrationError
from pipeline_tracker.geometry.camera import Camera, camera_from_projection
from pipeline_tracker.validation.inputs import check_camera_info, matrix_of, region_of

Array = NDArray[np.float64]

# Models of distortion as CameraInfo names them, and how many coefficients they may have.
_COEFFICIENTS = {
    "plumb_bob": (5, 4),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
_MATRICES = ("d", "k", "r", "p")
_EXACT = 1e-6
# A rotation written with few digits is still one.
_ROTATION_EXACT = 1e-3


@dataclass(frozen=True)
class RawCamera:
    """A camera whose images are not rectified, and the rectified camera that they lead to.

    Attributes:
        camera: the rectified camera; its size is that of the images.
        matrix: K of the image as it comes, row-major.
        model: of the distortion: plumb_bob, rational_polynomial or equidistant.
        coefficients: D.
        rotation: R, rectified <- own directions, row-major.
    """

    camera: Camera
    matrix: tuple[float, ...]
    model: str
    coefficients: tuple[float, ...]
    rotation: tuple[float, ...]


def camera_from_info(info: Any, *, name: str = "camera_info") -> Camera:
    """Return the rectified camera of a sensor_msgs/CameraInfo (its P, never its K).

    Raises:
        CalibrationError: see ``check_camera_info`` and ``camera_from_projection``.
    """
    check_camera_info(info, name)
    window = _window(info)
    projection = window.of_image(matrix_of(info, "p").reshape(3, 4))
    return camera_from_projection(projection, window.width, window.height, name=name)


def raw_camera_from_info(info: Any, *, name: str = "camera_info") -> RawCamera:
    """Return what a sensor_msgs/CameraInfo says about rectifying its camera's images.

    Raises:
        CalibrationError: K, D, R, P or the model are missing, impossible or unknown.
    """
    camera = camera_from_info(info, name=name)
    model, coefficients = _distortion(info, name)
    k, r = _square(info, "k", name), _square(info, "r", name)
    fx, fy = float(k[0, 0]), float(k[1, 1])
    if not (fx > 0 and fy > 0):
        raise CalibrationError(
            f"{name}: K has focal lengths fx={fx:g}, fy={fy:g}, expected both above 0; "
            "calibrate the camera"
        )
    rest = np.array([k[0, 1], k[1, 0], k[2, 0], k[2, 1], k[2, 2] - 1.0])
    if np.abs(rest).max() > _EXACT * fx:
        raise CalibrationError(
            f"{name}: K is {k.ravel().tolist()}, expected fx 0 cx 0 fy cy 0 0 1; "
            "calibrate the camera"
        )
    if np.abs(r @ r.T - np.eye(3)).max() > _ROTATION_EXACT or np.linalg.det(r) < 0:
        raise CalibrationError(
            f"{name}: R is {r.ravel().tolist()}, expected a rotation (1 0 0 0 1 0 0 0 1 for a "
            "camera alone); calibrate the camera"
        )
    k = _window(info).of_image(k)
    return RawCamera(camera, _tuple(k), model, coefficients, _tuple(r))


def is_rectified(info: Any) -> bool:
    """Tell whether images of this calibration are rectified as they come.

    They are without distortion and turn (R), and where K is given, it is P's. Matrices that are
    missing or zero say nothing.
    """
    d, k, r, p = (matrix_of(info, key) for key in _MATRICES)
    if np.any(d != 0.0):
        return False
    if r.size == 9 and r.any() and np.abs(r - np.eye(3).ravel()).max() > _EXACT:
        return False
    if k.size != 9 or p.size != 12 or not k.any() or not p.any():
        return True
    return bool(np.abs(k - p.reshape(3, 4)[:, :3].ravel()).max() <= _EXACT * np.abs(p).max())


def is_whole_sensor(info: Any) -> bool:
    """Tell whether K and P are those of the image itself: no binning, no region of interest."""
    across, down, x, y, width, height = _window_numbers(info)
    all_of_it = width in (0, int(info.width)) and height in (0, int(info.height))
    return max(across, down) <= 1 and x == y == 0 and all_of_it


def calibration_of(info: Any) -> tuple[Any, ...]:
    """Return all of a CameraInfo that counts here, to see whether another one says the same."""
    matrices = tuple(_tuple(matrix_of(info, key)) for key in _MATRICES)
    size = int(info.width), int(info.height)
    return (*size, str(info.distortion_model), *matrices, _window_numbers(info))


class _Window(NamedTuple):
    """Which part of the sensor the images are, and how many of its pixels make one of theirs."""

    x: int
    y: int
    width: int
    height: int
    across: int
    down: int

    def of_image(self, matrix: Array) -> Array:
        """Take K or P of the whole sensor to the image as it comes."""
        out = matrix.copy()
        if max(self.across, self.down) == 1 and self.x == self.y == 0:
            return out
        # Pixels count from their centres: the first of the image lies amid those that make it.
        out[0, 2] += 0.5 - self.x
        out[1, 2] += 0.5 - self.y
        out[0] /= self.across
        out[1] /= self.down
        out[:2, 2] -= 0.5
        return out


def _window(info: Any) -> _Window:
    across, down, x, y, width, height = _window_numbers(info)
    # 0 stands for the whole, and for no binning.
    across, down = max(across, 1), max(down, 1)
    width, height = width or int(info.width), height or int(info.height)
    return _Window(x, y, width // across, height // down, across, down)


def _window_numbers(info: Any) -> tuple[int, ...]:
    """Binning across and down, x, y, width and height of the region; 0 where nothing is said."""
    across, down = (int(getattr(info, key, 0)) for key in ("binning_x", "binning_y"))
    return (across, down, *region_of(info))


def _distortion(info: Any, name: str) -> tuple[str, tuple[float, ...]]:
    model, d = str(info.distortion_model), matrix_of(info, "d")
    if not d.any():
        return "plumb_bob", (0.0,) * 5
    known = _COEFFICIENTS.get(model)
    if known is None:
        raise CalibrationError(
            f"{name}: distortion_model is {model[:40]!r}, expected {', '.join(_COEFFICIENTS)}; "
            "calibrate the camera with one of these"
        )
    if d.size not in known:
        raise CalibrationError(
            f"{name}: D has {d.size} numbers, expected {' or '.join(str(n) for n in known)} for "
            f"{model}; calibrate the camera"
        )
    return model, _tuple(d)


def _square(info: Any, key: str, name: str) -> Array:
    found = matrix_of(info, key)
    if found.size != 9:
        raise CalibrationError(
            f"{name}: {key.upper()} has {found.size} numbers, expected 9; calibrate the camera"
        )
    return found.reshape(3, 3)


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values.ravel())
