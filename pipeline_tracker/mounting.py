"""Where the left camera sits on the vehicle: from settings, else from static transforms."""

from __future__ import annotations

import warnings
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline_tracker.errors import CalibrationError, SettingsError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.settings import Settings


class StaticTransforms:
    """Static transforms between frames, as /tf_static gives them."""

    def __init__(self) -> None:
        """Begin with none."""
        self._neighbours: dict[str, dict[str, Pose]] = {}

    def add(self, parent: str, child: str, pose: Pose) -> None:
        """Take in ``pose``: parent <- child; a later one of the same pair wins."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if parent != child:
            self._neighbours.setdefault(parent, {})[child] = pose
            self._neighbours.setdefault(child, {})[parent] = pose.inverse()

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted(self._neighbours)

    def between(self, target: str, source: str) -> Pose | None:
        """Return the pose target <- source along the shortest chain, None where there is none."""
        target, source = target.lstrip("/"), source.lstrip("/")
        found = {target: Pose.identity()}
        waiting = deque([target])
        while waiting and source not in found:
            frame = waiting.popleft()
            for neighbour, pose in self._neighbours.get(frame, {}).items():
                if neighbour not in found:
                    found[neighbour] = found[frame] @ pose
                    waiting.append(neighbour)
        if target == source:
            return None
        return found.get(source)


def mounting_from_settings(settings: Settings) -> Pose | None:
    """Return base_link <- left optical frame as the settings give it; None where they don't.

    Raises:
        SettingsError: one half of it is given without the other.
    """
    translation, rotation = settings.camera.translation, settings.camera.rotation_rpy
    if translation is None and rotation is None:
        return None
    if translation is None or rotation is None:
        given, missing = "camera.translation", "camera.rotation_rpy"
        if translation is None:
            given, missing = missing, given
        raise SettingsError(
            f"{given} is given without {missing}, expected both or neither; "
            f"add --set {missing}=[..., ..., ...]"
        )
    return Pose.from_rpy(translation, rotation)


def mounting_as_settings(mounting: Pose) -> dict[str, Any]:
    """Return base_link <- left optical frame as the settings that give it, by dotted key."""
    with warnings.catch_warnings():
        # Pitch of 90 degrees: one of many triples is given, and it is a right one.
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(mounting.rotation).as_euler("xyz")
    return {
        "camera.translation": mounting.translation.tolist(),
        "camera.rotation_rpy": angles.tolist(),
    }


def find_beam(
    settings: Settings, transforms: StaticTransforms, frame: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origin (m) and unit direction of the echo sounder's beam in base_link, (3,) each.

    Along +x of its own frame where a static transform of that frame is known, else by the settings
    ``altimeter.translation`` and ``altimeter.direction``.

    Args:
        settings: all settings.
        transforms: the static transforms that are known.
        frame: the frame that its messages name.
    """
    pose = transforms.between(settings.frames.base_link, frame) if frame else None
    if pose is not None:
        return pose.translation, pose.rotation[:, 0]
    direction = np.array(settings.altimeter.direction)
    return np.array(settings.altimeter.translation), direction / np.linalg.norm(direction)


def find_mounting(settings: Settings, transforms: StaticTransforms, left_frame: str) -> Pose:
    """Return base_link <- left optical frame: from the settings, else from static transforms.

    Args:
        settings: ``camera.translation`` and ``camera.rotation_rpy`` win.
        transforms: the static transforms that are known.
        left_frame: name of the left optical frame.

    Raises:
        SettingsError: one half of the mounting is given without the other.
        CalibrationError: neither gives it. The identity is never assumed: it would put the camera's
            view along the wrong axis and still give numbers.
    """
    given = mounting_from_settings(settings)
    if given is not None:
        return given
    base = settings.frames.base_link
    found = transforms.between(base, left_frame)
    if found is not None:
        return found
    known = ", ".join(transforms.frames[:8]) or "none"
    raise CalibrationError(
        f"the camera's mounting is not known: no static transform from {base} to "
        f"{left_frame or 'the left camera (its images name no frame)'} (frames in /tf_static: "
        f"{known}); give it with --set camera.translation=[x,y,z] and "
        "--set camera.rotation_rpy=[roll,pitch,yaw]"
    )
