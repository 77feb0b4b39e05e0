"""What the vehicle's visual navigation makes of its motion: drift, noise, dropouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline_tracker.geometry.pose import Pose, interpolate
from pipeline_tracker.simulation.axis import Wander
from pipeline_tracker.simulation.motion import Motion
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.vehicle_models import DropoutModel, VnmModel

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class VnmTrack:
    """Poses of the visual navigation.

    Attributes:
        stamps: (N,) int64, ns after the first pair, growing.
        poses: odom <- base_link.
        covariances: (N, 6, 6) of x, y, z (m) and the turns about odom's x, y, z (rad): what the
            model's errors add up to, not knowing which were drawn.
        twists: (N, 6) velocity and turning rate in base_link, m/s and rad/s, from the poses.
        twist_covariances: (N, 6, 6) of these.
        sent: (N,) whether the pose is sent, or falls into a dropout.
    """

    stamps: Stamps
    poses: list[Pose]
    covariances: Array
    twists: Array
    twist_covariances: Array
    sent: Mask


def vnm_track(motion: Motion, scenario: Scenario, rng: np.random.Generator) -> VnmTrack:
    """Let a visual navigation follow the true motion, adding up its errors.

    Its stamps are not those of the images; the first lies before the first pair, the last after
    the last. odom and world coincide at the first pair: there the interpolated pose is the true
    one, but for white noise.

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
    places, yaw = _walked(vnm, times, steps, rng)
    level = [Wander.draw(rng, 1.7 * np.deg2rad(vnm.level_error_deg), 25.0) for _ in range(2)]
    poses = [
        Pose.from_rpy(place, [0.0, 0.0, angle]) @ Pose(pose.rotation, np.zeros(3)) @ tilt
        for place, angle, pose, tilt in zip(places, yaw, true, _tilts(level, times), strict=True)
    ]
    poses = _aligned(stamps, poses, motion.pose(0.0))
    poses = _noisy(poses, vnm, rng)
    covariances = _covariances(vnm, times, steps, poses, level)
    dropouts = (*vnm.dropouts, *_random_dropouts(vnm, last, rng))
    return VnmTrack(
        stamps, poses, covariances, *_twists(vnm, stamps, poses), without(times, dropouts)
    )


def without(times: Array, dropouts: Sequence[DropoutModel]) -> Mask:
    """Return which of the times (N,), s after the first pair, lie in none of the dropouts, (N,)."""
    kept = np.ones(len(times), bool)
    for dropout in dropouts:
        kept &= (times < dropout.at) | (times >= dropout.at + dropout.duration)
    return kept


def _walked(
    vnm: VnmModel, times: Array, steps: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Add up the true steps (N - 1, 3) with their errors: places (N, 3) and errors of yaw (N,)."""
    walk = np.sqrt(np.linalg.norm(steps, axis=1))
    scale = 1.0 + vnm.scale * rng.standard_normal()
    turns = np.deg2rad(vnm.heading_drift_deg) * walk * rng.standard_normal(len(walk))
    yaw = np.concatenate([[0.0], np.cumsum(turns)])
    yaw -= np.interp(0.0, times, yaw)
    noise = vnm.drift * walk[:, None] * rng.standard_normal((len(walk), 3))
    middle = (yaw[:-1] + yaw[1:]) / 2.0
    turned = np.stack(
        [
            np.cos(middle) * steps[:, 0] - np.sin(middle) * steps[:, 1],
            np.sin(middle) * steps[:, 0] + np.cos(middle) * steps[:, 1],
            steps[:, 2],
        ],
        axis=1,
    )
    return np.vstack([np.zeros(3), np.cumsum(scale * turned + noise, axis=0)]), yaw


def _tilts(level: list[Wander], times: Array) -> list[Pose]:
    """Return slowly wandering errors of roll and pitch that are zero at time 0."""
    roll, pitch = level
    return [
        Pose.from_rpy(np.zeros(3), [float(roll(t) - roll(0.0)), float(pitch(t) - pitch(0.0)), 0.0])
        for t in times
    ]


def _aligned(stamps: Stamps, poses: list[Pose], true: Pose) -> list[Pose]:
    """Move all poses so that the one interpolated at time 0 is at the true place."""
    after = int(np.searchsorted(stamps, 0))
    fraction = -stamps[after - 1] / (stamps[after] - stamps[after - 1])
    start = interpolate(poses[after - 1], poses[after], float(fraction))
    shift = true.translation - start.translation
    return [Pose(pose.rotation, pose.translation + shift) for pose in poses]


def _noisy(poses: list[Pose], vnm: VnmModel, rng: np.random.Generator) -> list[Pose]:
    """Add white noise to each pose."""
    shifts = vnm.noise * rng.standard_normal((len(poses), 3))
    turns = np.deg2rad(vnm.rotation_noise_deg) * rng.standard_normal((len(poses), 3))
    return [
        Pose(Rotation.from_rotvec(turn).as_matrix() @ pose.rotation, pose.translation + shift)
        for pose, shift, turn in zip(poses, shifts, turns, strict=True)
    ]


def _covariances(
    vnm: VnmModel, times: Array, steps: Array, poses: list[Pose], level: list[Wander]
) -> Array:
    """Carry the variances of the errors along the way; (N, 6, 6)."""
    result = np.zeros((len(times), 6, 6))
    # x, y, z, yaw and scale, which is one number for the whole run; nothing has added up at 0.
    state = np.diag([0.0, 0.0, 0.0, 0.0, vnm.scale**2])
    start = int(np.searchsorted(times, 0.0)) - 1
    for n, pose in enumerate(poses):
        if n > start:
            state = _carried(vnm, steps[n - 1], state)
        result[n, :3, :3] = state[:3, :3] + vnm.noise**2 * np.eye(3)
        result[n, :3, 5] = result[n, 5, :3] = state[:3, 3]
        # Roll and pitch wander about the vehicle's own axes.
        tilt = [wander.variance_since_zero(float(times[n])) for wander in level]
        turns = pose.rotation @ np.diag([*tilt, 0.0]) @ pose.rotation.T
        turns += np.deg2rad(vnm.rotation_noise_deg) ** 2 * np.eye(3)
        result[n, 3:, 3:] = turns
        result[n, 5, 5] += state[3, 3]
    return result


def _carried(vnm: VnmModel, step: Array, state: Array) -> Array:
    """Carry the covariance of x, y, z, yaw, scale over one step (3,)."""
    way = float(np.linalg.norm(step))
    # An error of yaw turns the step, an error of scale lengthens it.
    turned = np.array([-step[1], step[0], 0.0])
    carry = np.eye(5)
    carry[:3, 3], carry[:3, 4] = turned, step
    # Of the turn within the step half is in effect.
    added = np.array([*(turned / 2.0), 1.0, 0.0])
    noise = np.deg2rad(vnm.heading_drift_deg) ** 2 * way * np.outer(added, added)
    noise[:3, :3] += vnm.drift**2 * way * np.eye(3)
    total: Array = carry @ state @ carry.T + noise
    return total


def _twists(vnm: VnmModel, stamps: Stamps, poses: list[Pose]) -> tuple[Array, Array]:
    """Return velocities in base_link from each pose's neighbours, (N, 6), and covariances."""
    twists, covariances = np.zeros((len(poses), 6)), np.zeros((len(poses), 6, 6))
    for n, pose in enumerate(poses):
        a, b = max(n - 1, 0), min(n + 1, len(poses) - 1)
        seconds = float(stamps[b] - stamps[a]) * 1e-9
        way = poses[b].translation - poses[a].translation
        turn = poses[a].rotation.T @ poses[b].rotation
        twists[n, :3] = pose.rotation.T @ way / seconds
        twists[n, 3:] = Rotation.from_matrix(turn).as_rotvec() / seconds
        length = float(np.linalg.norm(way))
        place = 2.0 * vnm.noise**2 + vnm.drift**2 * length + (vnm.scale * length) ** 2
        heading = np.deg2rad(vnm.heading_drift_deg) ** 2 * length
        angle = 2.0 * np.deg2rad(vnm.rotation_noise_deg) ** 2 + heading
        covariances[n] = np.diag([place] * 3 + [angle] * 3) / seconds**2
    return twists, covariances


def _random_dropouts(vnm: VnmModel, last: float, rng: np.random.Generator) -> list[DropoutModel]:
    """Draw dropouts between the first pair and the last, at ``last`` s."""
    count = int(rng.poisson(vnm.dropout_rate * last / 60.0))
    begins = rng.uniform(0.0, last, count)
    lengths = rng.exponential(vnm.dropout_duration, count)
    return [
        DropoutModel(at=float(begin), duration=float(np.clip(length, 1e-3, 1e6)))
        for begin, length in zip(begins, lengths, strict=True)
    ]
