"""How the vehicle goes along the pipe, and what its visual navigation makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose, interpolate
from pipeline_tracker.simulation.axis import PipeAxis, Wander
from pipeline_tracker.simulation.scenario import Scenario

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """The vehicle's true motion; time 0 is the first pair's.

    ``pose`` gives world <- base_link at any time.
    """

    axis: PipeAxis
    scenario: Scenario
    lateral: Wander
    distance: Wander
    heading: Wander
    pitch: Wander
    roll: Wander

    @classmethod
    def draw(cls, scenario: Scenario, axis: PipeAxis, rng: np.random.Generator) -> Motion:
        """Draw the swaying."""
        path = scenario.path
        angles = np.deg2rad([path.heading_sway_deg, path.pitch_sway_deg, path.roll_sway_deg])
        amplitudes = [path.lateral_sway, path.distance_sway, *angles]
        periods = path.sway_period * np.array([1.0, 1.2, 1.1, 0.8, 0.6])
        waves = [
            Wander.draw(rng, float(amplitude), float(period))
            for amplitude, period in zip(amplitudes, periods, strict=True)
        ]
        return cls(axis, scenario, *waves)

    def pose(self, time: float) -> Pose:
        """Return world <- base_link at a time, s."""
        step = 0.05
        before, after = self._place(time - step), self._place(time + step)
        way = after - before
        yaw = float(np.arctan2(way[1], way[0]) + self.heading(time))
        rotation = [float(self.roll(time)), float(self.pitch(time)), yaw]
        return Pose.from_rpy(self._place(time), rotation)

    def _place(self, time: float) -> Array:
        path = self.scenario.path
        s = path.speed * time
        # Leaves its first place without a jerk.
        settled = 1.0 - np.exp(-((max(s, 0.0) / path.lateral_settle) ** 3))
        aside = path.lateral_start + (path.lateral_end - path.lateral_start) * settled
        _, right, _ = self.axis.frames(s)
        place: Array = self.axis.points(s) - right * (aside + float(self.lateral(time)))
        camera = self.scenario.camera.translation[2]
        # Followed at a height that smooths the pipe's rise and fall, as an autopilot does.
        smooth = self.axis.points(s + np.linspace(-2.0, 2.0, 9))[:, 2].mean()
        height = path.distance + self.axis.radius - camera + float(self.distance(time))
        place[2] = smooth + height
        return place


@dataclass(frozen=True)
class VnmTrack:
    """Poses of the visual navigation.

    Attributes:
        stamps: (N,) int64, ns after the first pair, growing.
        poses: odom <- base_link.
    """

    stamps: NDArray[np.int64]
    poses: list[Pose]


def vnm_track(motion: Motion, scenario: Scenario, rng: np.random.Generator) -> VnmTrack:
    """Let a visual navigation follow the true motion, adding up its errors.

    Its stamps are not those of the images; the first lies before the first pair, the last after
    the last. odom and world coincide at the first pair: there the interpolated pose is the true
    one.

    Args:
        motion: the true motion.
        scenario: for the errors, the rate and the times of the pairs.
        rng: random numbers.
    """
    vnm, path = scenario.vnm, scenario.path
    interval = 1.0 / vnm.rate
    last = (scenario.frames - 1) * path.period
    count = int(np.ceil((last + 2.4 * interval) / interval)) + 1
    times = (np.arange(count) - 1.4 + rng.uniform(-0.02, 0.02, count)) * interval
    stamps = np.round(times * 1e9).astype(np.int64)
    true = [motion.pose(stamp * 1e-9) for stamp in stamps]
    steps = np.diff([pose.translation for pose in true], axis=0)
    ways = np.linalg.norm(steps, axis=1)
    walk = np.sqrt(ways)
    scale = 1.0 + vnm.scale * rng.standard_normal()
    turns = np.deg2rad(vnm.heading_drift_deg) * walk * rng.standard_normal(len(walk))
    yaw = np.concatenate([[0.0], np.cumsum(turns)])
    yaw -= np.interp(0.0, times, yaw)
    noise = vnm.drift * walk[:, None] * rng.standard_normal((len(walk), 3))
    level = _level_error(np.deg2rad(vnm.level_error_deg), times, rng)
    middle = (yaw[:-1] + yaw[1:]) / 2.0
    turned = np.stack(
        [
            np.cos(middle) * steps[:, 0] - np.sin(middle) * steps[:, 1],
            np.sin(middle) * steps[:, 0] + np.cos(middle) * steps[:, 1],
            steps[:, 2],
        ],
        axis=1,
    )
    places = np.vstack([np.zeros(3), np.cumsum(scale * turned + noise, axis=0)])
    poses = [
        Pose.from_rpy(place, [0.0, 0.0, angle]) @ Pose(pose.rotation, np.zeros(3)) @ tilt
        for place, angle, pose, tilt in zip(places, yaw, true, level, strict=True)
    ]
    return VnmTrack(stamps, _aligned(stamps, poses, motion.pose(0.0)))


def _level_error(sigma: float, times: Array, rng: np.random.Generator) -> list[Pose]:
    """Return slowly wandering errors of roll and pitch that are zero at time 0."""
    roll, pitch = (Wander.draw(rng, 1.7 * sigma, 25.0) for _ in range(2))
    return [
        Pose.from_rpy(np.zeros(3), [float(roll(t) - roll(0.0)), float(pitch(t) - pitch(0.0)), 0.0])
        for t in times
    ]


def _aligned(stamps: NDArray[np.int64], poses: list[Pose], true: Pose) -> list[Pose]:
    """Move all poses so that the one interpolated at time 0 is at the true place."""
    after = int(np.searchsorted(stamps, 0))
    fraction = -stamps[after - 1] / (stamps[after] - stamps[after - 1])
    start = interpolate(poses[after - 1], poses[after], float(fraction))
    shift = true.translation - start.translation
    return [Pose(pose.rotation, pose.translation + shift) for pose in poses]
