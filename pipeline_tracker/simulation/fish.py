"""Fish that swim before the cameras: where they are and what shape they have at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.simulation.axis import PipeAxis, Wander
from pipeline_tracker.simulation.meshes import grid_faces
from pipeline_tracker.simulation.pieces import Piece
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.streams import random_stream

Array = NDArray[np.float64]

# Along a fish from nose to tail fin: place, half height and half thickness, of its length.
_PROFILE = np.array(
    [
        [0.00, 0.000, 0.000],
        [0.02, 0.030, 0.022],
        [0.08, 0.075, 0.045],
        [0.18, 0.115, 0.066],
        [0.30, 0.135, 0.074],
        [0.42, 0.132, 0.070],
        [0.54, 0.108, 0.056],
        [0.66, 0.074, 0.038],
        [0.76, 0.042, 0.022],
        [0.82, 0.032, 0.014],
        [0.87, 0.060, 0.007],
        [0.93, 0.105, 0.004],
        [1.00, 0.135, 0.002],
    ]
)
_AROUND = 16
# Beats of the tail in a second, and how far it goes, of the length.
_BEAT, _SWING = 1.6, 0.09


@dataclass(frozen=True)
class Fish:
    """One fish.

    Attributes:
        length: m.
        ahead, aside, above: its way: ahead of the vehicle and to port of the axis, m, above the
            pipe's top, m, by time.
        middle: of the three, m.
        phase: of its tail, rad.
    """

    length: float
    ahead: Wander
    aside: Wander
    above: Wander
    middle: Array
    phase: float


@dataclass(frozen=True)
class School:
    """All fish of a scenario.

    Attributes:
        axis: the pipe's axis, along which they swim.
        speed: of the vehicle, which they accompany, m/s.
        fish: the fish.
        material: number of their material.
    """

    axis: PipeAxis
    speed: float
    fish: tuple[Fish, ...]
    material: int

    @classmethod
    def draw(cls, scenario: Scenario, axis: PipeAxis, material: int) -> School:
        """Draw a scenario's fish, each with its own random numbers."""
        model, distance = scenario.fish, scenario.path.distance
        members = []
        for n in range(model.count):
            rng = random_stream(scenario, "fish", n)
            low = min(0.25, 0.5 * model.highest * distance)
            middle = 0.5 * (low + model.highest * distance)
            ahead, aside, above = (
                Wander.draw(rng, amplitude, model.period * share)
                for amplitude, share in (
                    (0.6 * model.spread, 1.0),
                    (0.6 * model.spread, 0.8),
                    (middle - low, 1.3),
                )
            )
            off = rng.uniform(-0.4, 0.4, 2) * model.spread
            place = np.array([model.ahead + off[0], off[1], middle])
            length = model.length * float(np.clip(np.exp(0.3 * rng.standard_normal()), 0.4, 2.0))
            phase = float(rng.uniform(0.0, 2.0 * np.pi))
            members.append(Fish(length, ahead, aside, above, place, phase))
        return cls(axis, scenario.path.speed, tuple(members), material)

    def pieces(self, time: float) -> list[Piece]:
        """Return the fish at a time, s."""
        return [self._piece(fish, time) for fish in self.fish]

    def place(self, fish: Fish, time: float) -> Array:
        """Return where a fish is at a time, (3,), m, world."""
        ahead, aside, above = fish.middle + [
            float(way(time)) for way in (fish.ahead, fish.aside, fish.above)
        ]
        s = self.speed * time + ahead
        _, right, up = self.axis.frames(s)
        place: Array = self.axis.points(s) - aside * right + (self.axis.radius + above) * up
        return place

    def _piece(self, fish: Fish, time: float) -> Piece:
        place = self.place(fish, time)
        way = self.place(fish, time + 0.05) - self.place(fish, time - 0.05)
        # Fish climb and sink with little slope.
        way[2] *= 0.5
        forward = way / max(float(np.linalg.norm(way)), 1e-9)
        port = np.cross([0.0, 0.0, 1.0], forward)
        port /= max(float(np.linalg.norm(port)), 1e-9)
        rotation = np.stack([forward, port, np.cross(forward, port)], axis=1)
        beat = fish.phase + 2.0 * np.pi * _BEAT * time
        return fish_body(fish.length, beat, self.material).moved(rotation, place)


def fish_body(length: float, beat: float, material: int) -> Piece:
    """Return a fish that looks along x with its back to z, its middle at the origin.

    Args:
        length: m.
        beat: phase of its tail, rad.
        material: number of its material; the first coordinate is the way from the nose in
            lengths, the second -1 at the belly and 1 at the back.
    """
    along, high, thick = _PROFILE.T[:, :, None]
    angle = 2.0 * np.pi * np.arange(_AROUND)[None, :] / _AROUND
    bend = _SWING * along**2 * np.sin(beat - 5.0 * along)
    x = 0.45 - along + 0.0 * angle
    y = thick * np.sin(angle) + bend
    z = high * np.cos(angle)
    # Across the section's ellipse; the slope along the body matters little.
    normals = np.stack([0.0 * x, np.sin(angle) / (thick + 1e-3), np.cos(angle) / (high + 1e-3)], -1)
    normals[0, :, 0] = 1e4
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    coordinates = np.stack(np.broadcast_arrays(along, np.cos(angle)), axis=-1)
    return Piece(
        length * np.stack([x, y, z], axis=-1).reshape(-1, 3),
        grid_faces(len(_PROFILE), _AROUND, closed=True),
        normals.reshape(-1, 3),
        coordinates.reshape(-1, 2),
        material,
    )
