from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline_tracker.geometry.pose import Pose, interpolate
from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.motion import Motion, VnmTrack, vnm_track
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scene import draw_axis


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
    scenario = small("frames=20", "vnm.scale=0")
    ends = []
    for seed in range(30):
        motion, track = drawn(scenario, seed)
        ends.append(error(motion.pose(19.0), at(track, 19_000_000_000))[0])
    # 9.5 m: position walks 0.4 cm a root metre in 3 directions, heading 0.15 degrees a root metre.
    assert 0.012 < np.sqrt(np.mean(np.square(ends))) < 0.06


def test_the_vehicle_keeps_its_distance_and_its_course(small: Callable[..., Scenario]) -> None:
    scenario = small("frames=20")
    motion, _ = drawn(scenario)
    axis: PipeAxis = motion.axis
    left = scenario.camera.mounting()
    for t in np.arange(0.0, 20.0):
        base = motion.pose(float(t))
        camera = (base @ left).translation
        s, side = axis.nearest(camera)
        height = camera[2] - axis.points(s)[2] - axis.radius
        assert 1.6 < height < 2.4
        assert abs(side) < 0.9
        ahead = base.rotation[:, 0] @ axis.tangents(s)
        assert ahead > np.cos(np.deg2rad(15.0))
    # Beside the pipe at first, above it later.
    starts = axis.nearest(motion.pose(0.0).translation)[1]
    ends = axis.nearest(motion.pose(19.0).translation)[1]
    assert abs(starts - 0.45) < 0.11
    assert abs(ends) < 0.11
