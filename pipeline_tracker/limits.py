"""How fast it must be: the condition t1 <= t2 of 5.3.1, for planning and while running."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.cylinder import clip_line_to_view

Array = NDArray[np.float64]

# So far along the pipe, in distances from the camera, it can be told from the bed.
_REACH = 3.0
# Too little overlap so many times one after another is no single late image.
_SURE = 3
# Who stands still has all the time there is, m/s.
_SLOWEST = 1e-3


@dataclass(frozen=True)
class Plan:
    """A dive that is planned.

    Attributes:
        altitude: h, of the camera above the pipe, m.
        angle: 2 alpha, of view along the pipe, deg.
        tilt: of the camera from straight down, deg.
        overlap: p, share of an image that the next one shows again, 0 to below 1.
        speed: V, m/s.
    """

    altitude: float = 2.0
    angle: float = 60.0
    tilt: float = 0.0
    overlap: float = 0.7
    speed: float = 1.0

    def check(self) -> None:
        """Refuse what no dive can be.

        Raises:
            SettingsError: a number is out of its range, or the horizon is in view.
        """
        for name, value, low, high in (
            ("--altitude", self.altitude, 0.0, 1000.0),
            ("--angle", self.angle, 0.0, 180.0),
            ("--speed", self.speed, 0.0, 100.0),
        ):
            # Written so that NaN is refused.
            if not low < value <= high or (name == "--angle" and value == high):
                raise SettingsError(f"{name} {value:g}: expected above {low:g}, below {high:g}")
        if not 0.0 <= self.overlap < 1.0:
            raise SettingsError(f"--overlap {self.overlap:g}: expected 0 to below 1, such as 0.7")
        if not abs(self.tilt) + 0.5 * self.angle < 90.0:
            raise SettingsError(
                f"--tilt {self.tilt:g} with --angle {self.angle:g}: the horizon is in view, the "
                "seen length has no end; expected |tilt| + angle / 2 below 90"
            )

    @property
    def seen_length(self) -> float:
        """L, the length of pipe in view, m."""
        half, tilt = math.radians(0.5 * self.angle), math.radians(self.tilt)
        return self.altitude * (math.tan(tilt + half) - math.tan(tilt - half))

    @property
    def step(self) -> float:
        """S, the way that may lie between two images, m."""
        return self.seen_length * (1.0 - self.overlap)

    @property
    def time(self) -> float:
        """t2, the time that a frame may take, s."""
        return self.step / self.speed

    def in_words(self, spent: float | None = None) -> str:
        """Return a small table.

        Args:
            spent: t1, the time that a frame takes, s; None: not told.
        """
        rows = [
            ("seen length of the pipe", f"L = {self.seen_length:.3f} m"),
            (f"way between images, overlap {self.overlap:g}", f"S = {self.step:.3f} m"),
            (f"time for a frame at {self.speed:g} m/s", f"t2 = {1e3 * self.time:.0f} ms"),
            ("images in a second, at least", f"{1.0 / self.time:.2f}"),
        ]
        if spent is not None:
            holds = "holds" if spent <= self.time else "does not hold"
            rows += [
                ("time that a frame takes", f"t1 = {1e3 * spent:.0f} ms: t1 <= t2 {holds}"),
                ("fastest with that", f"{self.step / spent:.2f} m/s"),
            ]
        tilted = f", tilted by {self.tilt:g} deg" if self.tilt else ", looking straight down"
        head = f"{self.altitude:g} m above the pipe, {self.angle:g} deg of view{tilted} (5.3.1)"
        width = max(len(name) for name, _ in rows)
        return "\n".join([head, *(f"  {name:<{width}}  {value}" for name, value in rows)])


class Sight(NamedTuple):
    """A frame as 5.3.1 sees it.

    Attributes:
        overlap: share of the pipe in view that the frame before showed too, 0 to 1.
        warning: what the user should know; empty where there is nothing new.
        allowed: t2, the time that a frame may take at this speed, s; None where it is not known.
    """

    overlap: float
    warning: str = ""
    allowed: float | None = None


class OverlapWatch:
    """Watches how much of the pipe in one image the next one shows again."""

    def __init__(self, least: float) -> None:
        """Start without a past.

        Args:
            least: overlap below which it warns, 0 to 1.
        """
        self.least = least
        self._short = 0
        self._told = False

    def see(
        self, point: Array, direction: Array, way: float, seconds: float, camera: Camera
    ) -> Sight:
        """Take in a frame.

        Args:
            point, direction: of the pipe's axis, left optical frame, m.
            way: of the vehicle along the axis since the frame before, m.
            seconds: since then, s.
            camera: the left camera.

        Returns:
            Overlap, time allowed, and a warning the first time that the overlap was too small
            three times one after another.
        """
        view = clip_line_to_view(point, direction, camera)
        if view is None:
            return Sight(0.0)
        reach = _REACH * max(float(point[2]), 0.1)
        length = min(view[1], reach) - max(view[0], -reach)
        overlap = float(np.clip(1.0 - abs(way) / max(length, 1e-6), 0.0, 1.0))
        self._short = self._short + 1 if overlap < self.least else 0
        if not seconds > 0.0:
            return Sight(overlap)
        speed = abs(way) / seconds
        longest = length * (1.0 - self.least) / max(speed, _SLOWEST)
        if self._told or self._short < _SURE:
            return Sight(overlap, "", longest)
        self._told = True
        warning = (
            f"images are too far apart: {abs(way):.2f} m of {length:.2f} m in view, overlap "
            f"{overlap:.2f} (motion.min_overlap={self.least:g}); at {speed:.2f} m/s a frame may "
            f"take {1e3 * longest:.0f} ms, and they come every {1e3 * seconds:.0f} ms"
        )
        return Sight(overlap, warning, longest)
