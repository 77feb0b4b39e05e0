"""Pictures whose edges and disparities are known below a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Bar:
    """A straight bar across a picture.

    Attributes:
        width, height: of the picture, px.
        angle: direction of the bar, from x towards y (down), rad.
        thickness: px.
        offset: of its middle line from the picture's centre along its normal, px.
    """

    width: int = 240
    height: int = 180
    angle: float = 0.0
    thickness: float = 40.0
    offset: float = 0.0

    @property
    def normal(self) -> Array:
        """Unit vector across the bar, to the right of its direction as one looks at it."""
        return np.array([-math.sin(self.angle), math.cos(self.angle)])

    def across(self, pixels: Array) -> Array:
        """Place of pixels (N, 2) across the bar: 0 on its middle line, px."""
        centre = np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])
        return np.asarray((pixels - centre) @ self.normal - self.offset)

    def image(self, inside: float = 180.0, outside: float = 70.0) -> Image:
        """Draw it with smooth edges: each pixel has the mean over its own area, nearly."""
        ys, xs = np.mgrid[0 : self.height, 0 : self.width]
        depth = 0.5 * self.thickness - np.abs(self.across(np.stack((xs, ys), axis=-1)))
        # Over a pixel's square an edge is soft by its extent along the normal.
        extent = float(np.abs(self.normal).sum())
        share = np.clip(depth / extent + 0.5, 0.0, 1.0)
        return np.asarray(np.rint(outside + share * (inside - outside)), np.uint8)

    def visible_length(self, side: float, margin: float = 8.0) -> float:
        """Length of one edge (side -1 or +1) that lies inside the picture, px."""
        along = np.array([math.cos(self.angle), math.sin(self.angle)])
        centre = np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])
        foot = centre + (self.offset + side * 0.5 * self.thickness) * self.normal
        reach = math.hypot(self.width, self.height)
        places = foot + np.arange(-reach, reach, 0.5)[:, None] * along
        limit = [self.width - 1 - margin, self.height - 1 - margin]
        inside = (places >= margin).all(axis=1) & (places <= limit).all(axis=1)
        return 0.5 * float(inside.sum())


def texture(xs: Array, ys: Array, seed: int = 0, finest: float = 6.0) -> Array:
    """Random smooth texture at any places, 40 to 210: waves of ``finest`` px or longer."""
    random = np.random.default_rng(seed)
    total = np.zeros(np.broadcast(xs, ys).shape)
    for _ in range(40):
        length = finest * 8.0 ** random.random()
        angle, phase = random.uniform(0.0, 2.0 * math.pi, 2)
        total += np.cos(
            2.0 * math.pi / length * (xs * math.cos(angle) + ys * math.sin(angle)) + phase
        )
    return np.clip(125.0 + 15.0 * total, 40.0, 210.0)


def stereo_pair(
    disparity: float, width: int = 400, height: int = 160, slope: float = 0.0, seed: int = 0
) -> tuple[Image, Image]:
    """A textured plane in a left and a right image.

    Args:
        disparity: x_left - x_right at the left image's left border, px.
        width, height: px.
        slope: change of the disparity for each pixel of the left image.
        seed: of the texture.
    """
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float64)
    left = texture(xs, ys, seed)
    # x_right = x_left - disparity - slope * x_left.
    right = texture((xs + disparity) / (1.0 - slope), ys, seed)
    return np.asarray(np.rint(left), np.uint8), np.asarray(np.rint(right), np.uint8)
