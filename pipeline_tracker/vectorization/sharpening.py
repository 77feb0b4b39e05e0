"""Segments found in a shrunk image, put to their place in the full one (4.1.1).

Coarse to fine: edges are sought in a quarter of the pixels, and looked at closely only where they
are. It is their place that later accuracy rests on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.jit import compiled

Image = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

# The edge is sought up to so far to each side of the segment, px; a profile goes on by a pixel, for
# its slope.
_REACH = 2
_PROFILE = 2 * _REACH + 3
# Grey levels are averaged along so much of a segment before their slope is taken, px.
_BLOCK = 8.0
# Places off the line by more than this count less, px (Cauchy), in so many rounds.
_OFF, _ROUNDS = 0.5, 3


@compiled
def _add_profile(
    image: NDArray[np.uint8], x: float, y: float, nx: float, ny: float, profile: Float32Array
) -> None:
    """Add grey levels across an edge, a pixel apart, the middle one at x, y; inside the image."""
    width = image.shape[1]
    flat = image.ravel()
    for j in range(_PROFILE):
        u = np.float32(x + (j - _REACH - 1) * nx)
        v = np.float32(y + (j - _REACH - 1) * ny)
        column = int(u)
        row = int(v)
        fu = u - np.float32(column)
        fv = v - np.float32(row)
        place = row * width + column
        a = np.float32(flat[place])
        b = np.float32(flat[place + 1])
        c = np.float32(flat[place + width])
        d = np.float32(flat[place + width + 1])
        above = a + fu * (b - a)
        below = c + fu * (d - c)
        profile[j] += above + fv * (below - above)


@compiled
def _steepest(profile: Float32Array) -> tuple[float, float]:
    """Return where a profile rises the most, px from its middle, and how much; 0 where nowhere."""
    best = -1
    most = np.float32(0)
    for j in range(1, _PROFILE - 1):
        rise = profile[j + 1] - profile[j - 1]
        if rise > most:
            most = rise
            best = j
    if best < 2 or best >= _PROFILE - 2:
        # At its end it may rise further on: that is another edge.
        return 0.0, 0.0
    before = profile[best] - profile[best - 2]
    after = profile[best + 2] - profile[best]
    curvature = most + most - before - after
    if curvature <= 0.0:
        return 0.0, 0.0
    return best - (_REACH + 1) + 0.5 * (after - before) / curvature, float(most)


@compiled
def _fit_line(places: NDArray[np.float64], count: int, out: NDArray[np.float64]) -> bool:
    """Fit offset and tilt to places of an edge; those off the line count less and less.

    Args:
        places: (N, 3): way along the segment from its middle, place across it, px, and weight.
        count: of the places.
        out: (2,) filled: place across at the middle, px, and tilt.

    Returns:
        Whether the places tell a line.
    """
    for turn in range(_ROUNDS):
        sw = st = so = stt = sto = 0.0
        for k in range(count):
            t, off, w = places[k, 0], places[k, 1], places[k, 2]
            if turn > 0:
                away = (off - out[0] - out[1] * t) / _OFF
                w /= 1.0 + away * away
            sw += w
            st += w * t
            so += w * off
            stt += w * t * t
            sto += w * t * off
        spread = sw * stt - st * st
        if spread <= 0.0:
            return False
        out[1] = (sw * sto - st * so) / spread
        out[0] = (so - out[1] * st) / sw
    return True


@compiled
def sharpen(image: Image, segments: Float32Array) -> None:
    """Move segments across to where the image is steepest, in place.

    Where no steep place is seen close by, along at least half of a segment, it stays.

    Args:
        image: (H, W) uint8.
        segments: (N, 4) float32, x1 y1 x2 y2, px of the image, good to 2 px; the brighter side to
            the right of 1 -> 2.
    """
    height, width = image.shape
    longest = int((height + width) / _BLOCK) + 2
    places = np.empty((longest, 3))
    line = np.empty(2)
    profile = np.empty(_PROFILE, np.float32)
    for i in range(segments.shape[0]):
        x = float(segments[i, 0])
        y = float(segments[i, 1])
        ux = float(segments[i, 2]) - x
        uy = float(segments[i, 3]) - y
        length = np.sqrt(ux * ux + uy * uy)
        blocks = min(max(2, int(length / _BLOCK)), longest)
        steps = max(1, int(length / blocks))
        if length < 2.0:
            continue
        ux /= length
        uy /= length
        count = 0
        for b in range(blocks):
            profile[:] = 0
            inside = 0
            for k in range(steps):
                t = length * (b + (k + 0.5) / steps) / blocks
                px = x + t * ux
                py = y + t * uy
                # So far from the border that a profile in any direction is inside.
                room = min(min(px, width - 1 - px), min(py, height - 1 - py))
                if room >= _REACH + 2:
                    _add_profile(image, px, py, -uy, ux, profile)
                    inside += 1
            off, rise = _steepest(profile)
            if rise > 0.0 and inside == steps:
                places[count, 0] = length * ((b + 0.5) / blocks - 0.5)
                places[count, 1] = off
                places[count, 2] = rise
                count += 1
        if count < 2 or 2 * count < blocks or not _fit_line(places, count, line):
            continue
        first = line[0] - 0.5 * length * line[1]
        last = line[0] + 0.5 * length * line[1]
        if abs(first) > _REACH or abs(last) > _REACH:
            continue
        segments[i, 0] -= first * uy
        segments[i, 1] += first * ux
        segments[i, 2] -= last * uy
        segments[i, 3] += last * ux
