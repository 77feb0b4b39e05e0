"""How the vehicle goes along the pipe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
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
    surge: Wander

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
        waves.append(Wander.bounded(rng, path.speed_variation * path.speed, path.sway_period))
        return cls(axis, scenario, *waves)

    def pose(self, time: float) -> Pose:
        """Return world <- base_link at a time, s."""
        step = 0.05
        before, after = self._place(time - step), self._place(time + step)
        way = after - before
        turn = self._manoeuvres(time, "roll_deg", "pitch_deg", "heading_deg")
        roll, pitch, heading = np.deg2rad(turn)
        yaw = float(np.arctan2(way[1], way[0]) + self.heading(time) + heading)
        rotation = [float(self.roll(time)) + roll, float(self.pitch(time)) + pitch, yaw]
        return Pose.from_rpy(self._place(time), rotation)

    def chainage(self, time: float) -> float:
        """Return how far along the pipe the vehicle is, m."""
        return self.scenario.path.speed * time + float(self.surge(time) - self.surge(0.0))

    def _manoeuvres(self, time: float, *names: str) -> Array:
        """Add up what the manoeuvres do at a time, (names,)."""
        total = np.zeros(len(names))
        s = self.chainage(time)
        for manoeuvre in self.scenario.path.manoeuvres:
            beyond = max(abs(s - manoeuvre.at) - manoeuvre.length / 2.0, 0.0) / manoeuvre.settle
            t = max(1.0 - beyond, 0.0)
            # Speed and acceleration are zero at both ends.
            share = t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
            total += share * np.array([getattr(manoeuvre, name) for name in names])
        return total

    def _place(self, time: float) -> Array:
        path = self.scenario.path
        s = self.chainage(time)
        # Leaves its first place without a jerk.
        settled = 1.0 - np.exp(-((max(s, 0.0) / path.lateral_settle) ** 3))
        aside = path.lateral_start + (path.lateral_end - path.lateral_start) * settled
        lateral, higher = self._manoeuvres(time, "lateral", "distance")
        aside += float(self.lateral(time)) + lateral
        _, right, _ = self.axis.frames(s)
        place: Array = self.axis.points(s) - right * aside
        camera = self.scenario.camera.translation[2]
        # Followed at a height that smooths the pipe's rise and fall, as an autopilot does.
        smooth = self.axis.points(s + np.linspace(-2.0, 2.0, 9))[:, 2].mean()
        height = path.distance + self.axis.radius - camera + float(self.distance(time)) + higher
        place[2] = smooth + height
        return place
