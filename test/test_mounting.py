"""The camera's mounting: settings win, transforms are chained, the identity is never assumed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline_tracker.errors import CalibrationError, SettingsError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.mounting import (
    StaticTransforms,
    find_beam,
    find_mounting,
    mounting_as_settings,
    mounting_from_settings,
)
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import settings_from_values

PAN = Pose.from_rpy([0.5, 0.0, -0.2], [0.0, 0.3, 0.0])
CAMERA = Pose.from_rpy([0.0, 0.1, 0.0], [math.pi, 0.0, -math.pi / 2])


def settings(**values: object) -> Settings:
    given = {k.replace("__", "."): v for k, v in values.items()}
    return settings_from_values({"pipe.diameter": 0.6, **given})


def same(one: Pose | None, other: Pose) -> None:
    assert one is not None
    np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)
    np.testing.assert_allclose(one.translation, other.translation, atol=1e-12)


def chain() -> StaticTransforms:
    transforms = StaticTransforms()
    transforms.add("base_link", "pan", PAN)
    transforms.add("pan", "left_optical", CAMERA)
    transforms.add("base_link", "imu", Pose.identity())
    return transforms


def test_transforms_are_chained_in_both_directions() -> None:
    same(chain().between("base_link", "left_optical"), PAN @ CAMERA)
    same(chain().between("left_optical", "base_link"), (PAN @ CAMERA).inverse())
    same(chain().between("imu", "pan"), PAN)
    same(chain().between("/base_link", "/pan"), PAN)


def test_later_transform_wins_and_circles_end() -> None:
    transforms = chain()
    transforms.add("left_optical", "base_link", PAN)
    transforms.add("base_link", "left_optical", CAMERA)
    same(transforms.between("base_link", "left_optical"), CAMERA)
    assert transforms.between("base_link", "nowhere") is None
    assert transforms.between("base_link", "base_link") is None


def test_settings_win_over_transforms() -> None:
    given = settings(camera__translation=[1, 2, 3], camera__rotation_rpy=[0, 0, 0])
    same(find_mounting(given, chain(), "left_optical"), Pose.from_rpy([1, 2, 3], [0, 0, 0]))
    same(find_mounting(settings(), chain(), "left_optical"), PAN @ CAMERA)


def test_other_base_frame() -> None:
    same(find_mounting(settings(frames__base_link="pan"), chain(), "left_optical"), CAMERA)


@pytest.mark.parametrize("frame", ["right_optical", "base_link", ""])
def test_unknown_mounting_is_refused(frame: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        find_mounting(settings(), chain(), frame)
    line = str(caught.value)
    assert "the camera's mounting is not known" in line
    assert "--set camera.translation=" in line
    assert "--set camera.rotation_rpy=" in line
    assert "base_link, imu, left_optical, pan" in line


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ("camera.translation", "camera.rotation_rpy"),
        ("camera.rotation_rpy", "camera.translation"),
    ],
)
def test_half_a_mounting_is_refused(given: str, missing: str) -> None:
    half = settings_from_values({"pipe.diameter": 0.6, given: [0, 0, 0]})
    with pytest.raises(SettingsError, match=f"{given} is given without {missing}"):
        mounting_from_settings(half)


angles = st.floats(-math.pi, math.pi)


@given(angles, st.sampled_from([-math.pi / 2, 0.0, math.pi / 2]) | angles, angles)
def test_mounting_as_settings_comes_back(roll: float, pitch: float, yaw: float) -> None:
    mounting = Pose.from_rpy([0.1, 0.2, 0.3], [roll, pitch, yaw])
    given = settings_from_values({"pipe.diameter": 0.6, **mounting_as_settings(mounting)})
    found = mounting_from_settings(given)
    assert found is not None
    np.testing.assert_allclose(found.rotation, mounting.rotation, atol=1e-7)


def test_the_beam_is_along_x_of_its_own_frame_where_that_is_known() -> None:
    transforms = StaticTransforms()
    transforms.add(
        "base_link", "altimeter", Pose.from_rpy([0.1, 0.0, -0.2], [0.0, math.pi / 2, 0.0])
    )
    origin, direction = find_beam(settings(), transforms, "altimeter")
    np.testing.assert_allclose(origin, [0.1, 0.0, -0.2])
    np.testing.assert_allclose(direction, [0.0, 0.0, -1.0], atol=1e-12)


@pytest.mark.parametrize("frame", ["", "base_link", "unknown"])
def test_the_beam_is_that_of_the_settings_elsewhere(frame: str) -> None:
    given = settings(altimeter__translation=[0.2, 0.0, 0.1], altimeter__direction=[0.0, 3.0, -4.0])
    origin, direction = find_beam(given, chain(), frame)
    assert origin.tolist() == [0.2, 0.0, 0.1]
    np.testing.assert_allclose(direction, [0.0, 0.6, -0.8])


def test_a_beam_without_direction_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"altimeter\.direction"):
        settings(altimeter__direction=[0.0, 0.0, 0.0])
