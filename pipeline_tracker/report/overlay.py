"""Pictures of a result: what was found, drawn on the images it was found in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.types import Contours, Float32Array, Image, PipeSegment, State

Picture = NDArray[np.uint8]
_Colour = tuple[int, int, int]
# Blue, green, red. Told apart by colour-blind eyes too.
_SEGMENTS: _Colour = (190, 160, 90)
_LEFT_CONTOUR: _Colour = (0, 159, 230)
_RIGHT_CONTOUR: _Colour = (233, 180, 86)
_AXIS: _Colour = (66, 228, 240)
_TEXT: _Colour = (255, 255, 255)
_MAX_WIDTH = 2400
_NEAR = 0.05


@dataclass(frozen=True)
class _Kept:
    index: int
    quality: float
    left: Image
    right: Image | None
    result: FrameResult


class OverlayKeeper:
    """Keeps the frames worth a picture while a replay runs: the best and one from the middle."""

    def __init__(self, mounting: Pose, frame_count: int) -> None:
        """Begin.

        Args:
            mounting: base_link <- left optical frame.
            frame_count: number of frames expected.
        """
        self._mounting = mounting
        self._middle_index = frame_count // 2
        self._index = 0
        self._best: _Kept | None = None
        self._middle: _Kept | None = None

    def take(self, left: Image, right: Image | None, result: FrameResult) -> None:
        """Take in a processed frame; at most two are held."""
        state = result.relative_state
        kept = _Kept(self._index, state.quality, left, right, result)
        if state.valid and (self._best is None or kept.quality > self._best.quality):
            self._best = kept
        if self._middle is None or self._is_better_middle(kept, self._middle):
            self._middle = kept
        self._index += 1

    def write(self, directory: Path) -> list[Path]:
        """Write the pictures as PNG and return their paths.

        Raises:
            OSError: they cannot be written.
        """
        written = []
        pictures = {"overlay_best.png": self._best, "overlay_middle.png": self._middle}
        if self._best and self._middle and self._best.index == self._middle.index:
            pictures.pop("overlay_middle.png")
        for name, kept in pictures.items():
            if kept is not None:
                picture = draw_overlay(kept.left, kept.right, kept.result, self._mounting)
                _, data = cv2.imencode(".png", picture)
                (directory / name).write_bytes(data.tobytes())
                written.append(directory / name)
        return written

    def _is_better_middle(self, kept: _Kept, middle: _Kept) -> bool:
        valid, was = kept.result.relative_state.valid, middle.result.relative_state.valid
        if valid != was:
            return valid
        return abs(kept.index - self._middle_index) < abs(middle.index - self._middle_index)


def draw_overlay(left: Image, right: Image | None, result: FrameResult, mounting: Pose) -> Picture:
    """Draw a result on its images.

    Args:
        left, right: (H, W) uint8; right None in mono.
        result: what the pipeline said of them.
        mounting: base_link <- left optical frame.

    Returns:
        (h, w, 3) uint8, blue green red: left and right image side by side, their grey levels spread
        where they are few, with all segments (thin),
        the fitted contours (thick; one colour for the left one along travel, another for the right
        one), the axis piece with an arrow ahead, and the numbers.
    """
    rig, segment = result.vectorized.rig, result.tracked.segment
    images = [(left, rig.left, result.vectorized.left_segments)]
    if right is not None and rig.right is not None:
        images.append((right, rig.right, result.vectorized.right_segments))
    panels = [
        draw_panel(image, camera, segment, mounting, number=number, lines=lines)
        for number, (image, camera, lines) in enumerate(images)
    ]
    _write_numbers(panels[0], result)
    joined: Picture = np.hstack(panels)
    if joined.shape[1] > _MAX_WIDTH:
        scale = _MAX_WIDTH / joined.shape[1]
        small = cv2.resize(joined, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        joined = np.asarray(small, dtype=np.uint8)
    return joined


def draw_panel(
    image: Image,
    camera: Camera,
    segment: PipeSegment | None,
    mounting: Pose,
    *,
    number: int = 0,
    lines: Float32Array | None = None,
) -> Picture:
    """Draw what was found on one image, without words.

    Args:
        image: (H, W) uint8.
        camera: its camera.
        segment: the pipe in base_link; None where there is none.
        mounting: base_link <- left optical frame.
        number: 0 for the left image, 1 for the right one.
        lines: (N, 4) float32, x1 y1 x2 y2 px: all segments, drawn thin; None: left out.

    Returns:
        (H, W, 3) uint8, blue green red; see ``draw_overlay``.
    """
    panel: Picture = np.asarray(cv2.cvtColor(_stretched(image), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    width = 2 * max(1, round(camera.width / 600))
    for x1, y1, x2, y2 in () if lines is None else lines.astype(np.float64):
        _line(panel, (x1, y1), (x2, y2), _SEGMENTS, 1)
    if segment is not None and segment.found:
        _draw_contours(panel, segment, number, width)
        _draw_axis(panel, segment, camera, mounting, width)
    return panel


def _stretched(image: Image) -> Image:
    """Spread the grey levels of a dark or hazy picture for the eye."""
    low, high = (float(v) for v in np.percentile(image, (0.5, 99.5)))
    # More would show the noise, and a uniform picture has nothing to spread.
    gain = min(3.0, 230.0 / max(high - low, 1.0)) if high - low > 10.0 else 1.0
    if gain <= 1.0:
        return image
    return np.asarray(np.clip((image - low) * gain + 10.0, 0.0, 255.0), dtype=np.uint8)


def _draw_contours(panel: Picture, segment: PipeSegment, image: int, width: int) -> None:
    bits = [bit for bit in Contours if bit and bit in segment.visible_contours]
    for bit, (x1, y1, x2, y2) in zip(bits, segment.contours.astype(np.float64), strict=False):
        in_right_image = bit in (Contours.RIGHT_IMAGE_LEFT, Contours.RIGHT_IMAGE_RIGHT)
        if in_right_image == bool(image):
            is_left = bit in (Contours.LEFT_IMAGE_LEFT, Contours.RIGHT_IMAGE_LEFT)
            colour = _LEFT_CONTOUR if is_left else _RIGHT_CONTOUR
            _line(panel, (x1, y1), (x2, y2), colour, width)


def _draw_axis(
    panel: Picture, segment: PipeSegment, camera: Camera, mounting: Pose, width: int
) -> None:
    ends = mounting.inverse().apply(np.stack((segment.start, segment.end)))
    if (ends[:, 2] < _NEAR).any():
        return
    (x1, y1), (x2, y2) = camera.project(ends)
    _line(panel, (x1, y1), (x2, y2), _AXIS, width, arrow=True)


def _line(
    panel: Picture,
    start: tuple[float, float],
    end: tuple[float, float],
    colour: _Colour,
    width: int,
    *,
    arrow: bool = False,
) -> None:
    points = np.array([start, end], dtype=np.float64)
    # OpenCV takes 32-bit integers; what lies so far outside is not to be drawn.
    if not (np.isfinite(points).all() and np.abs(points).max() < 1e5):
        return
    # 4 binary digits below the pixel.
    one, other = (tuple(int(v) for v in point) for point in np.rint(points * 16))
    if arrow:
        cv2.arrowedLine(panel, one, other, colour, width, cv2.LINE_AA, 4, 0.12)
    else:
        cv2.line(panel, one, other, colour, width, cv2.LINE_AA, 4)


def _write_numbers(panel: Picture, result: FrameResult) -> None:
    status, state = result.tracked.status, result.relative_state
    words = status.state.name.lower() + ("" if state.valid else ", not valid")
    lines = [words + (f": {status.reason}" if status.reason else "")]
    if status.state != State.SEARCHING and result.tracked.segment is not None:
        heading = math.degrees(state.heading_misalignment)
        pitch = math.degrees(state.pitch_misalignment)
        side = state.side.name.lower().replace("_", " ")
        lines += [
            f"distance {state.min_distance:.3f} m  support {status.support:.2f}",
            f"heading {heading:+.1f} deg  pitch {pitch:+.1f} deg",
            f"lateral {state.lateral_offset:+.3f} m  side: {side}",
        ]
    scale = panel.shape[1] / 1200.0
    step, thick = round(32 * scale) + 4, max(1, round(2 * scale))
    for number, line in enumerate(lines, start=1):
        x, y = round(12 * scale), number * step
        # An outline of the same weight: newer OpenCV sets heavier letters wider.
        for dx, dy in ((-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)):
            colour = _TEXT if dx == 0 else (0, 0, 0)
            place, font = (x + dx * thick, y + dy * thick), cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(panel, line, place, font, 0.9 * scale, colour, thick, cv2.LINE_AA)
