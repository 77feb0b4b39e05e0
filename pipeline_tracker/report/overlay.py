"""Pictures of a result: what was found, drawn on the images it was found in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.files import write_whole
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.report.caption import caption
from pipeline_tracker.report.shapes import ContourShape, FrameShapes, frame_shapes, scaled
from pipeline_tracker.types import Float32Array, Image, PipeSegment

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
_Colour = tuple[int, int, int]
# Blue, green, red. Told apart by colour-blind eyes too.
_SEGMENTS: _Colour = (167, 121, 204)
_LEFT_CONTOUR: _Colour = (0, 159, 230)
_RIGHT_CONTOUR: _Colour = (233, 180, 86)
_AXIS: _Colour = (66, 228, 240)
_TEXT: _Colour = (255, 255, 255)
_OUTLINE: _Colour = (0, 0, 0)
_LEGEND = (
    ("left contour", _LEFT_CONTOUR),
    ("right contour", _RIGHT_CONTOUR),
    ("axis", _AXIS),
    ("broken: expected; shaded: 95 % of where it may lie", _TEXT),
)
_MAX_WIDTH = 2400
# Share of a band's own colour where it covers the picture.
_BAND_WEIGHT = 0.35
_DASH = 14.0
# OpenCV takes 32-bit integers; what lies so far outside, px, is not to be drawn.
_NOWHERE = 1e5


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
                write_whole(directory / name, data.tobytes())
                written.append(directory / name)
        return written

    def _is_better_middle(self, kept: _Kept, middle: _Kept) -> bool:
        valid, was = kept.result.relative_state.valid, middle.result.relative_state.valid
        if valid != was:
            return valid
        return abs(kept.index - self._middle_index) < abs(middle.index - self._middle_index)


def draw_overlay(
    left: Image,
    right: Image | None,
    result: FrameResult,
    mounting: Pose | None,
    title: str = "",
    max_width: int = _MAX_WIDTH,
) -> Picture:
    """Draw a result on its images.

    Args:
        left, right: (H, W) uint8; right None in mono.
        result: what the pipeline said of them.
        mounting: base_link <- left optical frame; None: not known, only what was seen is drawn.
        title: a line above the numbers; with it comes a legend at the foot.
        max_width: of the whole picture, px; wider images are made smaller.

    Returns:
        (h, w, 3) uint8, blue green red: left and right image side by side, their grey levels spread
        where they are few, with all segments (thin),
        the fitted contours (thick; one colour for the left one along travel, another for the right
        one), where the axis expects a contour that was not found (broken), the band in which the
        contours lie with 95 % (shaded; too narrow to be seen where the pipe was found well), the
        axis piece with an arrow ahead, and the numbers.
    """
    rig = result.vectorized.rig
    images = [(left, rig.left, result.vectorized.left_segments)]
    if right is not None and rig.right is not None:
        images.append((right, rig.right, result.vectorized.right_segments))
    scale = min(1.0, max_width / (len(images) * rig.left.width))
    segment = result.tracked.segment
    panels = [
        draw_panel(image, camera, segment, mounting, number=number, lines=lines, scale=scale)
        for number, (image, camera, lines) in enumerate(images)
    ]
    _write_numbers(panels[0], result, title)
    if title:
        _write_legend(panels[0])
    return np.hstack(panels)


def draw_panel(
    image: Image,
    camera: Camera,
    segment: PipeSegment | None,
    mounting: Pose | None,
    *,
    number: int = 0,
    lines: Float32Array | None = None,
    scale: float = 1.0,
) -> Picture:
    """Draw what was found on one image, without words.

    Args:
        image: (H, W) uint8.
        camera: its camera.
        segment: the pipe in base_link; None where there is none.
        mounting: base_link <- left optical frame; None: not known, only what was seen is drawn.
        number: 0 for the left image, 1 for the right one.
        lines: (N, 4) float32, x1 y1 x2 y2 px: all segments, drawn thin; None: left out.
        scale: size of the picture in that of the image, at most 1.

    Returns:
        (h, w, 3) uint8, blue green red; see ``draw_overlay``.
    """
    if scale < 1.0:
        size = round(image.shape[1] * scale), round(image.shape[0] * scale)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    panel: Picture = np.asarray(cv2.cvtColor(_stretched(image), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    if lines is not None:
        _lines(panel, scaled(lines.astype(np.float64).reshape(-1, 2, 2), scale), _SEGMENTS, 1)
    if segment is not None:
        shapes = frame_shapes(segment, camera, number, mounting)
        _draw_shapes(panel, shapes.scaled(scale), max(1, round(panel.shape[1] / 600)))
    return panel


def _stretched(image: Image) -> Image:
    """Spread the grey levels of a dark or hazy picture for the eye."""
    # A sixteenth of the pixels tells it as well.
    low, high = (float(v) for v in np.percentile(image[::4, ::4], (0.5, 99.5)))
    # More would show the noise, and a uniform picture has nothing to spread.
    gain = min(3.0, 230.0 / max(high - low, 1.0)) if high - low > 10.0 else 1.0
    if gain <= 1.0:
        return image
    return np.asarray(np.clip((image - low) * gain + 10.0, 0.0, 255.0), dtype=np.uint8)


def _draw_shapes(panel: Picture, shapes: FrameShapes, width: int) -> None:
    for contour in shapes.contours:
        _draw_band(panel, contour)
    for contour in shapes.contours:
        colour = _LEFT_CONTOUR if contour.is_left else _RIGHT_CONTOUR
        if contour.seen is not None:
            _line(panel, contour.seen, colour, 2 * width, outline=width)
        elif contour.expected is not None:
            _broken_line(panel, contour.expected, colour, width + 1)
    if shapes.axis is not None:
        _line(panel, shapes.axis, _AXIS, 2 * width, outline=width, arrow=True)


def _draw_band(panel: Picture, contour: ContourShape) -> None:
    if contour.band is None or not _drawable(contour.band):
        return
    height, width = panel.shape[:2]
    low = np.clip(np.floor(contour.band.min(axis=0)) - 1, 0, (width, height)).astype(int)
    high = np.clip(np.ceil(contour.band.max(axis=0)) + 2, 0, (width, height)).astype(int)
    if not (low < high).all():
        return
    part = panel[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros(part.shape[:2], np.uint8)
    corners = np.rint((contour.band - low) * 16).astype(np.int32)
    cv2.fillPoly(mask, [corners], 255, cv2.LINE_AA, 4)
    inside = mask > 0
    weight = _BAND_WEIGHT / 255.0 * mask[inside].astype(np.float32)[:, None]
    colour = np.array(_LEFT_CONTOUR if contour.is_left else _RIGHT_CONTOUR, np.float32)
    part[inside] = part[inside] * (1.0 - weight) + colour * weight


def _broken_line(panel: Picture, line: Array, colour: _Colour, width: int) -> None:
    if not _drawable(line):
        return
    count = max(1, round(float(np.linalg.norm(line[1] - line[0])) / (_DASH * width)))
    shares = np.linspace(0.0, 1.0, 2 * count)[:, None]
    dashes = (line[0] + shares * (line[1] - line[0])).reshape(-1, 2, 2)
    _lines(panel, dashes, _OUTLINE, width + 2)
    _lines(panel, dashes, colour, width)


def _lines(panel: Picture, lines: Array, colour: _Colour, width: int) -> None:
    """Draw many lines, (N, 2, 2) px, at once."""
    near = lines[(np.abs(lines) < _NOWHERE).all(axis=(1, 2))]
    corners = np.rint(near[:, :, None, :] * 16).astype(np.int32)
    cv2.polylines(panel, list(corners), False, colour, width, cv2.LINE_AA, 4)


def _line(
    panel: Picture,
    line: Array,
    colour: _Colour,
    width: int,
    *,
    outline: int = 0,
    arrow: bool = False,
) -> None:
    if not _drawable(line):
        return
    # 4 binary digits below the pixel.
    one, other = (tuple(int(v) for v in point) for point in np.rint(line * 16))
    # A dark line below keeps a bright one apart from bright sand.
    strokes = [(_OUTLINE, width + 2 * outline), (colour, width)][0 if outline else 1 :]
    for paint, weight in strokes:
        if arrow:
            cv2.arrowedLine(panel, one, other, paint, weight, cv2.LINE_AA, 4, 0.12)
        else:
            cv2.line(panel, one, other, paint, weight, cv2.LINE_AA, 4)


def _drawable(points: Array) -> bool:
    return bool((np.abs(points) < _NOWHERE).all())


def _write_numbers(panel: Picture, result: FrameResult, title: str) -> None:
    scale = panel.shape[1] / 1200.0
    lines = caption(result.tracked.status, result.tracked.segment, result.relative_state)
    if title:
        lines.insert(0, title)
    for number, line in enumerate(lines, start=1):
        _write(panel, line, round(12 * scale), number * (round(32 * scale) + 4), 0.9 * scale)


def _write_legend(panel: Picture) -> None:
    scale = panel.shape[1] / 1200.0
    x, y = round(12 * scale), panel.shape[0] - round(14 * scale)
    for words, colour in _LEGEND:
        x += _write(panel, words, x, y, 0.7 * scale, colour) + round(24 * scale)


def _write(panel: Picture, words: str, x: int, y: int, size: float, colour: _Colour = _TEXT) -> int:
    """Write a line with its baseline at (x, y); return its width in px."""
    thick, font = max(1, round(2 * panel.shape[1] / 1200.0)), cv2.FONT_HERSHEY_SIMPLEX
    # An outline of the same weight: newer OpenCV sets heavier letters wider.
    for dx, dy in ((-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)):
        paint = colour if dx == 0 else _OUTLINE
        place = (x + dx * thick, y + dy * thick)
        cv2.putText(panel, words, place, font, size, paint, thick, cv2.LINE_AA)
    return int(cv2.getTextSize(words, font, size, thick)[0][0])
