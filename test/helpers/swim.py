"""A vehicle that swims over a made-up world with recognizer and tracker, frame by frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from synthetic_world import SECOND, Diver

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.settings import Settings
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker


def settings_of(**sections: dict[str, object]) -> Settings:
    """Settings with a pipe of 0.6 m and what is given."""
    return Settings.model_validate({"pipe": {"diameter": 0.6}, **sections})


class Swim:
    """Tracker and recognizer of one vehicle.

    Attributes:
        diver: what it sees; may be replaced between frames.
        asked: how often the recognizer was asked.
    """

    def __init__(
        self, diver: Diver, settings: Settings | None = None, recognition_only: bool = False
    ) -> None:
        settings = settings or settings_of()
        self.diver = diver
        self.tracker = Tracker(settings, diver.mounting, recognition_only)
        self.recognizer = Recognizer(settings, diver.mounting)
        self.asked = 0

    def step(
        self, seconds: float, pose: Pose, seed: int | None = None, known: Pose | None = None
    ) -> TrackedFrame:
        """Process the frame at a true pose.

        Args:
            seconds: its time, s.
            pose: the true pose.
            seed: of what it sees; its time in ms where not given.
            known: the pose that the vehicle believes in; the true one where not given.
        """
        return self.process(seconds, pose, pose if known is None else known, seed)

    def blind(self, seconds: float, pose: Pose) -> TrackedFrame:
        """Process the frame at a true pose that the vehicle does not know."""
        return self.process(seconds, pose, None, None)

    def process(
        self, seconds: float, pose: Pose, known: Pose | None, seed: int | None
    ) -> TrackedFrame:
        stamp = round(seconds * SECOND)
        frame = self.diver.frame(pose, stamp, round(1000 * seconds) if seed is None else seed)
        done = self.tracker.begin(frame, known)
        if done is None:
            self.asked += 1
            done = self.tracker.finish(self.recognizer.recognize(frame))
        return done

    def lose_pipe(self) -> None:
        """From now on the pipe is gone, the bed remains."""
        self.diver = replace(self.diver, world=replace(self.diver.world, pipe=None))


def middle(frame: TrackedFrame) -> NDArray[np.float64]:
    """Middle of a frame's segment, (3,), m."""
    assert frame.segment is not None
    return np.asarray(0.5 * (frame.segment.start + frame.segment.end))
