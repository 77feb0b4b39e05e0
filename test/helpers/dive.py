"""A dive vectorized once, to be tracked with numbers right and wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.self_check import SelfCheck
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import load_settings, replace_settings
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer

Change = Callable[[VectorizedStereo, Pose], tuple[VectorizedStereo, Pose | None]]


@dataclass(frozen=True)
class Dive:
    """Vectorized frames with their poses, and what they were made with."""

    settings: Settings
    mounting: Pose
    frames: list[tuple[VectorizedStereo, Pose]]

    def tracked(
        self, settings: Settings, mounting: Pose, change: Change | None = None
    ) -> Iterator[TrackedFrame]:
        """Track all frames, changed."""
        tracker, recognizer = Tracker(settings, mounting), Recognizer(settings, mounting)
        for frame, pose in self.frames:
            seen, there = (frame, pose) if change is None else change(frame, pose)
            tracked = tracker.begin(seen, there)
            yield tracker.finish(recognizer.recognize(seen)) if tracked is None else tracked

    def warnings(
        self,
        change: Change | None = None,
        turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
        diameter: float = 0.6,
    ) -> list[str]:
        """Return all that the check says, with the mounting turned (rpy, rad), frames changed."""
        settings = replace_settings(self.settings, {"pipe.diameter": diameter})
        rotation = Pose.from_rpy([0.0, 0.0, 0.0], turn).rotation
        mounting = Pose(rotation @ self.mounting.rotation, self.mounting.translation)
        check = SelfCheck(settings, mounting)
        frames = self.tracked(settings, mounting, change)
        return [told for frame in frames for told in check.see(frame)]


def other_baseline(share: float) -> Change:
    """Return a change of the calibration: the baseline is ``share`` times what it is."""

    def change(frame: VectorizedStereo, pose: Pose) -> tuple[VectorizedStereo, Pose]:
        assert frame.rig.right is not None
        right = replace(frame.rig.right, offset=share * frame.rig.right.offset)
        return replace(frame, rig=StereoRig(frame.rig.left, right)), pose

    return change


def scaled_poses(scale: float) -> Change:
    """Return a change of the poses: ways are ``scale`` times what they are."""
    return lambda frame, pose: (frame, Pose(pose.rotation, scale * pose.translation))


def vectorized(path: Path, diameter: float, count: int) -> Dive:
    """Vectorize the first frames of a bag."""
    settings = load_settings(None, [f"pipe.diameter={diameter:g}"])
    poses = PoseBuffer(settings.pose.max_gap)
    frames: list[tuple[VectorizedStereo, Pose]] = []
    with BagReader(path) as bag:
        source = ReplayInput(bag, settings)
        vectorizer = Vectorizer(source.settings)
        for frame in source.frames(poses, lambda: None):
            assert frame.rig is not None
            assert frame.left is not None
            pose = poses.at(frame.stamp_ns)
            assert pose is not None
            found = vectorizer.process(frame.stamp_ns, frame.rig, frame.left, frame.right)
            frames.append((found, pose))
            if len(frames) == count:
                break
    return Dive(source.settings, source.mounting, frames)
