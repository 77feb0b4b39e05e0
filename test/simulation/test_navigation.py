from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline_tracker.geometry.pose import Pose, interpolate
from pipeline_tracker.simulation.motion import Motion
from pipeline_tracker.simulation.navigation import VnmTrack, vnm_track, without
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scene import draw_axis
from pipeline_tracker.simulation.vehicle_models import DropoutModel


def drawn(scenario: Scenario, seed: int = 3) -> tuple[Motion, VnmTrack]:
    rng = np.random.default_rng(seed)
    motion = Motion.draw(scenario, draw_axis(scenario, rng), rng)
    return motion, vnm_track(motion, scenario, rng)


def at(track: VnmTrack, stamp: int) -> Pose:
    after = int(np.searchsorted(track.stamps, stamp))
    assert 0 < after < len(track.stamps)
    a, b = track.stamps[after - 1], track.stamps[after]
    return interpolate(track.poses[after - 1], track.poses[after], float((stamp - a) / (b - a)))


def error(true: Pose, estimate: Pose) -> tuple[float, float]:
    turn = Rotation.from_matrix(true.rotation.T @ estimate.rotation).magnitude()
    return float(np.linalg.norm(true.translation - estimate.translation)), float(turn)


def test_odom_and_world_coincide_at_the_first_pair_only(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20")
    motion, track = drawn(scenario)
    way, turn = error(motion.pose(0.0), at(track, 0))
    assert way < 1e-9
    assert turn < 1e-4
    ways = [error(motion.pose(float(t)), at(track, int(t * 1e9)))[0] for t in range(1, 20)]
    assert min(ways[2:]) > 1e-4
    assert 0.003 < ways[-1] < 0.2


def test_a_pose_on_either_side_of_each_pair_but_none_at_it(small: Callable[..., Scenario]) -> None:
    for rate in (1.3, 10.0, 50.0):
        scenario = small("frames=5", "path.period=0.5", f"vnm.rate={rate}")
        _, track = drawn(scenario)
        assert (np.diff(track.stamps) > 0).all()
        assert track.stamps[0] < 0
        assert track.stamps[-1] > 2_000_000_000
        if rate == 10.0:
            assert not set(track.stamps) & {0, 500_000_000, 1_000_000_000}


def test_without_errors_the_navigation_is_true_but_for_interpolation(
    small: Callable[..., Scenario],
) -> None:
    scenario = small(
        "frames=20",
        "vnm.drift=0",
        "vnm.scale=0",
        "vnm.heading_drift_deg=0",
        "vnm.level_error_deg=0",
    )
    motion, track = drawn(scenario)
    for t in range(20):
        way, turn = error(motion.pose(float(t)), at(track, int(t * 1e9)))
        assert way < 2e-4
        assert turn < 1e-4


def test_drift_grows_with_the_way(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20", "vnm.rate=2", "vnm.scale=0")
    ends = []
    for seed in range(30):
        motion, track = drawn(scenario, seed)
        ends.append(error(motion.pose(19.0), at(track, 19_000_000_000))[0])
    # 9.5 m: position walks 0.4 cm a root metre in 3 directions, heading 0.15 degrees a root metre.
    assert 0.012 < np.sqrt(np.mean(np.square(ends))) < 0.06


def test_white_noise_is_that_of_the_scenario(small: Callable[..., Scenario]) -> None:
    exact = small("frames=60", "vnm.noise=0", "vnm.rotation_noise_deg=0")
    noisy = small("frames=60", "vnm.noise=0.02", "vnm.rotation_noise_deg=0.3")
    _, one = drawn(exact)
    _, two = drawn(noisy)
    shifts = np.array(
        [b.translation - a.translation for a, b in zip(one.poses, two.poses, strict=True)]
    )
    turns = np.array(
        [
            Rotation.from_matrix(b.rotation @ a.rotation.T).as_rotvec()
            for a, b in zip(one.poses, two.poses, strict=True)
        ]
    )
    # 590 poses: the standard deviation is known to 3 %.
    np.testing.assert_allclose(shifts.std(axis=0), 0.02, rtol=0.12)
    np.testing.assert_allclose(turns.std(axis=0), np.deg2rad(0.3), rtol=0.12)
    assert np.abs(np.corrcoef(shifts[:-1, 0], shifts[1:, 0])[0, 1]) < 0.15


def test_the_covariance_is_honest(small: Callable[..., Scenario]) -> None:
    scenario = small(
        "frames=20", "vnm.rate=2", "vnm.noise=0.01", "vnm.rotation_noise_deg=0.1", "vnm.scale=0.01"
    )
    rng = np.random.default_rng(3)
    motion = Motion.draw(scenario, draw_axis(scenario, rng), rng)
    squares = []
    for seed in range(100):
        track = vnm_track(motion, scenario, np.random.default_rng(seed))
        errors = []
        for n in (10, 25, len(track.poses) - 1):
            true = motion.pose(track.stamps[n] * 1e-9)
            turn = Rotation.from_matrix(track.poses[n].rotation @ true.rotation.T).as_rotvec()
            error = np.append(track.poses[n].translation - true.translation, turn)
            covariance = track.covariances[n]
            np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
            errors.append(error @ np.linalg.solve(covariance, error) / 6.0)
        squares.append(errors)
    # The mean of 100 chi squares with 6 degrees of freedom over 6: sigma 0.058.
    np.testing.assert_allclose(np.mean(squares, axis=0), 1.0, atol=0.18)


def test_the_velocities_are_those_of_the_poses(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20", "vnm.noise=0.005")
    motion, track = drawn(scenario)
    true, found, sigma = [], [], []
    for n in range(1, len(track.stamps) - 1):
        a, b = (motion.pose(track.stamps[k] * 1e-9) for k in (n - 1, n + 1))
        seconds = (track.stamps[n + 1] - track.stamps[n - 1]) * 1e-9
        middle = motion.pose(track.stamps[n] * 1e-9)
        true.append(middle.rotation.T @ (b.translation - a.translation) / seconds)
        found.append(track.twists[n, :3])
        sigma.append(np.sqrt(np.diag(track.twist_covariances[n])[:3]))
    relative = (np.array(found) - true) / sigma
    assert 0.8 < np.sqrt(np.mean(relative**2)) < 1.2


def test_dropouts_leave_no_pose(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20", "vnm.dropouts=[{at: 3, duration: 2.5}, {at: 18, duration: 99}]")
    _, track = drawn(scenario)
    seconds = track.stamps * 1e-9
    expected = ~(((seconds >= 3) & (seconds < 5.5)) | (seconds >= 18))
    # A stamp is a rounded time.
    near = np.min(np.abs(seconds[:, None] - [3, 5.5, 18]), axis=1) < 1e-8
    np.testing.assert_array_equal(track.sent[~near], expected[~near])
    whole = drawn(small("frames=20"))[1]
    assert whole.sent.all()
    # What is sent is what would have been sent without them.
    np.testing.assert_allclose(track.poses[10].translation, whole.poses[10].translation, atol=1e-12)


def test_dropouts_at_random_have_their_rate(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=61", "vnm.dropout_rate=3", "vnm.dropout_duration=2", "vnm.rate=1")
    motion, _ = drawn(scenario)
    lost = [
        1.0 - vnm_track(motion, scenario, np.random.default_rng(seed)).sent.mean()
        for seed in range(60)
    ]
    # Three of 2 s in 60 s, now and then over each other or over the end: 9.5 %.
    assert 0.06 < np.mean(lost) < 0.13
    assert np.std(lost) > 0.01


def test_without_takes_the_beginning_and_leaves_the_end() -> None:
    times = np.array([0.9, 1.0, 1.5, 2.0])
    kept = without(times, [DropoutModel(at=1.0, duration=1.0)])
    assert kept.tolist() == [True, False, False, True]
    assert without(times, []).all()
