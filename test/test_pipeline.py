"""Pictures and poses in, relative state out: the four steps in one call."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rendering import SMALL, pair
from swim import settings_of
from synthetic_world import DOWN, SECOND, Diver, World, level_pose

from pipeline_tracker.echoes import Echo
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult, Pipeline, warm_up
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.tracking.tracker import Tracker
from pipeline_tracker.types import Mode, RelativeState, Side, State
from pipeline_tracker.vectorization.vectorizer import Vectorizer

Image = NDArray[np.uint8]

WORLD = World.with_pipe(heading=0.15, ahead=0.3, aside=0.1)
BARE = World(WORLD.bed)
PERIOD = 0.5


def pose_of(k: float) -> Pose:
    """Forward at 0.5 m/s, sinking at 5 cm/s."""
    return level_pose(x=0.25 * k, z=-0.025 * k)


@pytest.fixture(scope="module")
def pictures() -> list[tuple[Image, Image | None]]:
    """Pictures of four frames with the pipe, and of one without."""
    frames = [pair(WORLD, pose_of(k), DOWN, seed=k) for k in range(4)]
    return [*frames, pair(BARE, pose_of(4), DOWN, seed=4)]


def process(
    pipeline: Pipeline,
    pictures: list[tuple[Image, Image | None]],
    poses: bool = True,
    rig: StereoRig = SMALL,
) -> list[FrameResult]:
    results = []
    for k, (left, right) in enumerate(pictures):
        stamp = round(k * PERIOD * SECOND)
        if poses:
            pipeline.poses.add(stamp, pose_of(k))
        results.append(pipeline.process(stamp, rig, left, None if rig.right is None else right))
    return results


def plain(state: RelativeState) -> list[object]:
    """A relative state as values that can be compared."""
    return [v.tolist() if isinstance(v, np.ndarray) else v for v in vars(state).values()]


def test_pictures_become_the_relative_state(
    pictures: list[tuple[Image, Image | None]],
) -> None:
    results = process(Pipeline(settings_of(), DOWN), pictures[:4])
    assert WORLD.pipe is not None
    diver = Diver(WORLD, SMALL)
    for k, result in enumerate(results):
        pose = pose_of(k)
        assert result.tracked.status.state == State.TRACKING
        # Only the first frame asks the recognizer.
        assert (result.recognition is not None) == (k == 0)
        assert result.tracked.segment is not None
        away, turn = diver.errors(result.tracked.segment, pose)
        assert away < 0.01
        assert turn < math.radians(0.6)
        state = result.relative_state
        assert state.stamp_ns == round(k * PERIOD * SECOND)
        assert state.valid
        assert 0.5 < state.quality <= 1.0
        # By hand: distance of the left camera, and of base_link, from the axis less the radius.
        camera = pose.apply(DOWN.translation)
        for got, place in (
            (state.min_distance, camera),
            (state.min_distance_base, pose.translation),
        ):
            assert got == pytest.approx(WORLD.pipe.from_axis(place[None])[0] - 0.3, abs=0.01)
        # The motion of 1 s is known after 1 s; the pipe leads 0.15 rad to port of it, as of the
        # vehicle's own axis.
        assert state.motion_observed == (k > 1)
        assert state.heading_misalignment == pytest.approx(0.15, abs=0.01)
        way = 0.25 * math.cos(0.15)
        assert state.chainage == pytest.approx(k * way, abs=0.01)
        if k > 1:
            # It sinks towards a level pipe.
            climb = math.atan2(0.025, 0.25)
            assert state.pitch_misalignment == pytest.approx(climb, abs=0.01)
            assert state.approach_speed == pytest.approx(0.05, abs=0.02)
        aside = (0.25 * k - 0.3) * math.sin(0.15) + 0.1 * math.cos(0.15)
        assert state.lateral_offset == pytest.approx(-aside, abs=0.01)


def test_a_bed_without_pipe_is_searched(pictures: list[tuple[Image, Image | None]]) -> None:
    results = process(Pipeline(settings_of(), DOWN), [pictures[4]] * 2)
    for result in results:
        assert result.tracked.status.state == State.SEARCHING
        assert result.tracked.status.reason == "pipe_not_found"
        assert result.tracked.segment is None
        assert result.recognition is not None
        assert not result.recognition.found
        assert not result.relative_state.valid
        assert result.relative_state.side == Side.NOT_IN_VIEW


def test_a_pipe_that_ends_is_coasted(pictures: list[tuple[Image, Image | None]]) -> None:
    last = process(Pipeline(settings_of(), DOWN), pictures)[4]
    assert last.tracked.status.state == State.COASTING
    assert last.recognition is not None
    assert not last.recognition.found
    assert last.tracked.segment is not None
    assert Diver(WORLD, SMALL).errors(last.tracked.segment, pose_of(4))[0] < 0.02
    assert not last.relative_state.valid
    assert last.relative_state.quality == 0.0


def test_it_does_what_its_steps_do(pictures: list[tuple[Image, Image | None]]) -> None:
    results = process(Pipeline(settings_of(), DOWN), pictures)
    settings = settings_of()
    vectorizer = Vectorizer(settings)
    recognizer, tracker = Recognizer(settings, DOWN), Tracker(settings, DOWN)
    for k, ((left, right), result) in enumerate(zip(pictures, results, strict=True)):
        frame = vectorizer.process(round(k * PERIOD * SECOND), SMALL, left, right)
        assert np.array_equal(frame.left_segments, result.vectorized.left_segments)
        assert np.array_equal(frame.matches, result.vectorized.matches)
        tracked = tracker.begin(frame, pose_of(k))
        if tracked is None:
            tracked = tracker.finish(recognizer.recognize(frame))
        assert tracked.segment is not None
        assert result.tracked.segment is not None
        assert np.array_equal(tracked.segment.start, result.tracked.segment.start)
        assert np.array_equal(tracked.segment.covariance, result.tracked.segment.covariance)
        assert replace(tracked.status, processing_time=0.0) == replace(
            result.tracked.status, processing_time=0.0
        )


def test_two_runs_give_the_same_bits(pictures: list[tuple[Image, Image | None]]) -> None:
    first, second = (process(Pipeline(settings_of(), DOWN), pictures) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert plain(a.relative_state) == plain(b.relative_state)


def test_a_reset_starts_anew(pictures: list[tuple[Image, Image | None]]) -> None:
    pipeline = Pipeline(settings_of(), DOWN)
    process(pipeline, pictures[:2])
    pipeline.reset("clock_jump")
    assert len(pipeline.poses) == 0
    # Earlier stamps are taken again.
    results = process(pipeline, pictures[:2])
    assert results[0].tracked.status.reason == "clock_jump"
    for result in results:
        assert result.tracked.status.reset_counter == 1
        assert result.relative_state.reset_counter == 1
        assert result.tracked.status.state == State.TRACKING
    assert results[0].recognition is not None
    assert results[1].recognition is None
    assert results[1].relative_state.chainage == pytest.approx(0.25 * math.cos(0.15), abs=0.01)


def test_without_poses_each_frame_stands_alone(
    pictures: list[tuple[Image, Image | None]],
) -> None:
    for result in process(Pipeline(settings_of(), DOWN), pictures[:2], poses=False):
        assert result.recognition is not None
        assert result.tracked.status.reason == "no_pose"
        assert result.relative_state.valid
        assert not result.relative_state.motion_observed
        assert result.relative_state.speed_variance == -1.0
        assert result.relative_state.heading_misalignment == pytest.approx(0.15, abs=0.02)


def test_recognition_only_asks_for_every_frame(
    pictures: list[tuple[Image, Image | None]],
) -> None:
    for result in process(Pipeline(settings_of(), DOWN, recognition_only=True), pictures[:3]):
        assert result.recognition is not None
        assert result.tracked.segment is not None
        assert result.tracked.segment.mode == Mode.RECOGNITION


def hear(pipeline: Pipeline, frames: int) -> None:
    """Ping the pipe below ten times in each period, from well before the first frame on."""
    for n in range(-40, 10 * frames):
        stamp = round(n * PERIOD / 10 * SECOND)
        pose = pose_of(n / 10)
        pipeline.poses.add(stamp, pose)
        down = np.array([0.0, 0.0, -1.0])
        distance = float(WORLD.hit(pose.translation, down[None])[0])
        pipeline.echoes.add(stamp, Echo(stamp, np.zeros(3), down, distance, 0.01, 0.0))


def test_one_camera_and_an_echo_sounder_are_enough(
    pictures: list[tuple[Image, Image | None]],
) -> None:
    mono = settings_of().model_copy(update={"mode": "mono"})
    pipeline = Pipeline(mono, DOWN)
    hear(pipeline, 3)
    results = process(pipeline, pictures[:3], poses=False, rig=StereoRig(SMALL.left, None))
    for k, result in enumerate(results):
        assert result.tracked.status.state == State.TRACKING
        assert result.tracked.segment is not None
        assert len(result.vectorized.matches) == 0
        assert Diver(WORLD, SMALL).errors(result.tracked.segment, pose_of(k))[0] < 0.02


def test_one_camera_alone_does_not_guess(pictures: list[tuple[Image, Image | None]]) -> None:
    mono = settings_of().model_copy(update={"mode": "mono"})
    results = process(Pipeline(mono, DOWN), pictures[:3], rig=StereoRig(SMALL.left, None))
    for result in results:
        assert result.recognition is not None
        assert result.recognition.found
        assert not result.relative_state.valid
        assert result.tracked.status.reason in {"contours_not_clear", "too_uncertain"}


def test_warming_up_goes_through_all_steps_and_is_done_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames: list[FrameResult] = []
    process = Pipeline.process

    def counted(self: Pipeline, *frame: Any) -> FrameResult:
        frames.append(process(self, *frame))
        return frames[-1]

    monkeypatch.setattr(Pipeline, "process", counted)
    warm_up.cache_clear()
    warm_up()
    assert all(frame.relative_state.valid for frame in frames)
    techniques = [frame.recognition and frame.recognition.technique for frame in frames]
    assert techniques == [4, None, 4, None, 1, None, 2, None, 3, None]
    warm_up()
    assert len(frames) == len(techniques)


def test_where_nothing_is_kept_another_process_compiles_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    start = subprocess.Popen

    def noted(*command: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start(*command, **options))
        return started[-1]

    found: list[FrameResult] = []
    follow = Pipeline.follow

    def counted(self: Pipeline, *frame: Any) -> FrameResult:
        found.append(follow(self, *frame))
        return found[-1]

    monkeypatch.setattr("pipeline_tracker.pipeline.kernels_are_kept", lambda: False)
    monkeypatch.setattr("pipeline_tracker.pipeline.cores", lambda: 2)
    monkeypatch.setattr("pipeline_tracker.pipeline.subprocess.Popen", noted)
    monkeypatch.setattr(Pipeline, "follow", counted)
    warm_up.cache_clear()
    warm_up()
    assert [process.returncode for process in started] == [0]
    techniques = [frame.recognition and frame.recognition.technique for frame in found]
    # Without images first, then with them.
    assert techniques == 2 * [4, None, 4, None, 1, None, 2, None, 3, None]
    assert all(frame.relative_state.valid for frame in found)


def test_after_warming_up_nothing_is_left_to_compile(tmp_path: Path) -> None:
    # In processes of their own: here, other tests have compiled what they need.
    helper = Path(__file__).parent / "helpers" / "late_compilation.py"
    frames = tmp_path / "frames"
    for stage in ([], ["VECTORIZATION"], ["RECOGNITION"], ["TRACKING"]):
        found = subprocess.run(
            [sys.executable, str(helper), str(frames), *stage],
            capture_output=True,
            text=True,
            check=False,
        )
        assert found.returncode == 0, found.stderr
        assert found.stdout.split() == [], stage
