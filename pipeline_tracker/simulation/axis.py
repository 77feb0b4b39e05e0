"""The pipe's axis: a gently bending curve in the world, by chainage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree

from pipeline_tracker.simulation.scenario import PipeModel

Array = NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])
# Steps of the integration and of the spline's knots, m.
_FINE, _KNOT = 0.005, 0.05


@dataclass(frozen=True)
class Wander:
    """A smooth random function: three sines whose amplitudes add up to ``amplitude``.

    Attributes:
        amplitudes, frequencies, phases: (3,), frequencies in rad per unit of the argument.
    """

    amplitudes: Array
    frequencies: Array
    phases: Array

    @classmethod
    def draw(cls, rng: np.random.Generator, amplitude: float, period: float) -> Wander:
        """Draw one with periods around ``period``."""
        shares = np.array([0.6, 0.25, 0.15])
        periods = period * np.array([1.0, 0.61, 1.7]) * rng.uniform(0.9, 1.1, 3)
        return cls(amplitude * shares, 2.0 * np.pi / periods, rng.uniform(0.0, 2.0 * np.pi, 3))

    @classmethod
    def bounded(cls, rng: np.random.Generator, steepest: float, period: float) -> Wander:
        """Draw one whose slope keeps below ``steepest``."""
        shape = cls.draw(rng, 1.0, period)
        return cls(shape.amplitudes * steepest / shape.steepest(), shape.frequencies, shape.phases)

    def __call__(self, at: ArrayLike) -> Array:
        """Return its values at an array of arguments, same shape."""
        x = np.asarray(at, dtype=np.float64)[..., None]
        total: Array = np.sum(self.amplitudes * np.sin(self.frequencies * x + self.phases), axis=-1)
        return total

    def variance_since_zero(self, at: float) -> float:
        """Return the variance of its difference to the value at 0, over all phases."""
        return float(np.sum(self.amplitudes**2 * (1.0 - np.cos(self.frequencies * at))))

    def steepest(self) -> float:
        """Return a bound of its slope."""
        return float(np.sum(self.amplitudes * self.frequencies))


@dataclass(frozen=True)
class PipeAxis:
    """The axis as a curve by chainage s (m), world coordinates.

    Attributes:
        start, end: range of s.
        radius: of the pipe, m.
    """

    start: float
    end: float
    radius: float
    _curve: CubicHermiteSpline
    _tree: cKDTree

    @classmethod
    def draw(cls, pipe: PipeModel, start: float, end: float, rng: np.random.Generator) -> PipeAxis:
        """Draw an axis through the world's origin at s = 0, roughly along the world's x.

        Args:
            pipe: the pipe's model; its radii bound the curvature.
            start, end: range of chainage, m, with 0 inside.
            rng: random numbers.
        """
        # The directions wander so that their slopes, the curvatures, keep to the least radii.
        way = _Way(
            Wander.bounded(rng, 1.0 / pipe.bend_radius, pipe.bend_length),
            Wander.bounded(rng, 1.0 / pipe.sag_radius, pipe.sag_length),
            1.0 / pipe.curve_radius if pipe.curve_radius else 0.0,
            float(np.deg2rad(pipe.slope_deg)),
        )
        # Whole knots, so that one of them lies at 0.
        first, last = np.floor(start / _KNOT), np.ceil(end / _KNOT)
        every = round(_KNOT / _FINE)
        s = _FINE * np.arange(first * every, last * every + 1)
        mid = s[:-1] + _FINE / 2.0
        steps = _FINE * way.direction(mid)
        points = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        s, points = s[::every], points[::every]
        points -= points[np.argmin(np.abs(s))]
        curve = CubicHermiteSpline(s, points, way.direction(s))
        return cls(float(s[0]), float(s[-1]), pipe.diameter / 2.0, curve, cKDTree(points[:, :2]))

    def points(self, s: ArrayLike) -> Array:
        """Return axis points (..., 3), m."""
        value: Array = self._curve(np.clip(s, self.start, self.end))
        return value

    def tangents(self, s: ArrayLike) -> Array:
        """Return unit tangents (..., 3), towards growing s."""
        value: Array = self._curve(np.clip(s, self.start, self.end), 1)
        value /= np.linalg.norm(value, axis=-1, keepdims=True)
        return value

    def frames(self, s: ArrayLike) -> tuple[Array, Array, Array]:
        """Return unit tangent, right (horizontal) and up (normal) vectors, each (..., 3)."""
        tangent = self.tangents(s)
        right = np.cross(tangent, _UP)
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        return tangent, right, np.cross(right, tangent)

    def nearest(self, places: ArrayLike) -> tuple[Array, Array]:
        """Find the axis nearest to places seen from above.

        Args:
            places: (..., 2) or (..., 3), m; heights are not looked at.

        Returns:
            Chainage (...) and horizontal distance (...), positive to port, m.
        """
        p = np.asarray(places, dtype=np.float64)[..., :2]
        _, index = self._tree.query(p)
        s = self.start + index * _KNOT
        # One step along the tangent: the knots are dense against the bends.
        tangent = self.tangents(s)[..., :2]
        offset = p - self.points(s)[..., :2]
        level = np.sum(tangent * tangent, axis=-1)
        s = np.clip(s + np.sum(offset * tangent, axis=-1) / level, self.start, self.end)
        offset = p - self.points(s)[..., :2]
        side = (tangent[..., 0] * offset[..., 1] - tangent[..., 1] * offset[..., 0]) / np.sqrt(
            level
        )
        return s, side


@dataclass(frozen=True)
class _Way:
    """Where the axis leads: a wandering heading and elevation beside a steady curve and slope.

    Attributes:
        heading, elevation: rad, by chainage.
        curvature: to port, 1/m.
        slope: upward, rad.
    """

    heading: Wander
    elevation: Wander
    curvature: float
    slope: float

    def direction(self, s: NDArray[Any]) -> Array:
        """Return unit directions; the headings are counted from the one at s = 0."""
        angle = self.heading(s) - self.heading(0.0) + self.curvature * s
        slope = self.elevation(s) + self.slope
        level = np.cos(slope)
        return np.stack([level * np.cos(angle), level * np.sin(angle), np.sin(slope)], axis=-1)
