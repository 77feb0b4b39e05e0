"""A contact sheet of the worst frames: what was found beside what is true, to see the cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.contours import HIDDEN, VISIBLE, TrueContours
from pipeline_tracker.evaluation.recording import read_left_images
from pipeline_tracker.evaluation.replay import Estimate, Replay
from pipeline_tracker.evaluation.schema import FrameFigures
from pipeline_tracker.evaluation.truth import Truth
from pipeline_tracker.types import Contours, Image, PipeSegment

Picture = NDArray[np.uint8]
_Colour = tuple[int, int, int]

WORST = "evaluation_worst.png"
_COLUMNS, _WIDTH = 2, 800
# Blue, green, red. Told apart by colour-blind eyes too.
_TRUE: _Colour = (115, 158, 0)
_TRUE_HIDDEN: _Colour = (66, 228, 240)
_FOUND: _Colour = (0, 94, 213)
_WHITE: _Colour = (255, 255, 255)
_LEFT_IMAGE = (Contours.LEFT_IMAGE_LEFT, Contours.LEFT_IMAGE_RIGHT)


def worst_frames(frames: Sequence[FrameFigures], count: int) -> list[int]:
    """Choose the frames that are worth a look.

    First those that are false valid, then those that could have been found and were not, then the
    valid ones of the greatest divergence.

    Returns:
        Indices of at most ``count`` frames, the worst first.
    """
    missed = [bool(f.detectable) and not f.valid for f in frames]
    seen = [k for k, f in enumerate(frames) if f.valid or missed[k]]

    def badness(k: int) -> tuple[bool, bool, float]:
        return bool(frames[k].false_reasons), missed[k], frames[k].total or 0.0

    return sorted(seen, key=badness, reverse=True)[:count]


def write_worst(
    replay: Replay, truth: Truth, frames: Sequence[FrameFigures], count: int
) -> Path | None:
    """Draw the worst frames of a replay into one picture in its directory.

    Green: the true contours where they are visible, yellow where they are hidden; red: the lines
    that the segment has for them.

    Args:
        replay: the replay.
        truth: its truth.
        frames: its figures, frame by frame.
        count: how many at most.

    Returns:
        The file; None where no frame is worth a look, or the bag has no images of them.

    Raises:
        BagError: the bag cannot be read.
        EvaluationError: the file cannot be written.
    """
    chosen = worst_frames(frames, count)
    images = read_left_images(truth.path, replay.settings, {frames[k].stamp_ns for k in chosen})
    tiles = [
        _tile(images[frames[k].stamp_ns], k, frames[k], replay, truth)
        for k in chosen
        if frames[k].stamp_ns in images
    ]
    if not tiles:
        return None
    height = max(tile.shape[0] for tile in tiles)
    blank = np.zeros((height, _WIDTH, 3), np.uint8)
    tiles += [blank] * (-len(tiles) % _COLUMNS)
    rows = [np.hstack(tiles[k : k + _COLUMNS]) for k in range(0, len(tiles), _COLUMNS)]
    path = replay.directory / WORST
    _, data = cv2.imencode(".png", np.vstack(rows))
    try:
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise EvaluationError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def _tile(
    image: Image, number: int, figures: FrameFigures, replay: Replay, truth: Truth
) -> Picture:
    scale = _WIDTH / image.shape[1]
    size = (_WIDTH, round(scale * image.shape[0]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    picture: Picture = np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), np.uint8)
    stamp = figures.stamp_ns
    if stamp in truth.contours[0]:
        _draw_true(picture, truth.contours[0][stamp], scale)
    segment = replay.segments.get(stamp)
    if segment is not None and segment.found:
        for line in _found_lines(segment):
            ends = _places(line.reshape(2, 2), scale)
            if len(ends) == 2:
                cv2.line(picture, ends[0], ends[1], _FOUND, 1, cv2.LINE_AA)
    for row, text in enumerate(in_words(number, figures, replay.estimates[number]), start=1):
        # An outline of the same weight: newer OpenCV sets heavier letters wider.
        for dx, dy in ((-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)):
            colour = _WHITE if dx == 0 else (0, 0, 0)
            place, font = (8 + dx, 22 * row + dy), cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(picture, text, place, font, 0.55, colour, 1, cv2.LINE_AA)
    return picture


def in_words(number: int, figures: FrameFigures, estimate: Estimate) -> list[str]:
    """Say what became of a frame, in short lines."""
    kind = "valid" if figures.valid else "not valid"
    if figures.false_reasons:
        kind = f"FALSE VALID ({', '.join(figures.false_reasons)})"
    lines = [f"frame {number}: {figures.state or 'lost'}, {kind}"]
    if estimate.reason:
        lines.append(estimate.reason)
    if figures.horizontal is not None and figures.vertical is not None:
        lines.append(
            f"sum of both ends: horizontal {100.0 * figures.horizontal:.2f} cm, "
            f"vertical {100.0 * figures.vertical:.2f} cm"
        )
    if figures.offsets is not None and figures.sigmas is not None:
        left, up = (
            f"{name} {100.0 * off:+.2f} (sigma {100.0 * sigma:.2f}) cm"
            for name, off, sigma in zip(
                ("left", "up"), figures.offsets, figures.sigmas, strict=False
            )
        )
        lines.append(f"{left}, {up}")
    return lines


def _draw_true(picture: Picture, contours: TrueContours, scale: float) -> None:
    for side in range(len(contours.pixels)):
        for flag, colour in ((HIDDEN, _TRUE_HIDDEN), (VISIBLE, _TRUE)):
            for point in _places(contours.pixels[side][contours.flags[side] == flag], scale):
                cv2.circle(picture, point, 1, colour, -1, cv2.LINE_AA)


def _found_lines(segment: PipeSegment) -> Iterator[NDArray[np.float64]]:
    bits = [bit for bit in Contours if bit and bit in segment.visible_contours]
    for bit, line in zip(bits, segment.contours.astype(np.float64), strict=False):
        if bit in _LEFT_IMAGE:
            yield line


def _places(pixels: NDArray[np.float64], scale: float) -> list[tuple[int, int]]:
    """Return pixels of the image as whole pixels of a smaller one; far ones are left out."""
    small = (pixels + 0.5) * scale - 0.5
    near = np.isfinite(small).all(axis=1) & (np.abs(small) < 1e4).all(axis=1)
    return [(round(x), round(y)) for x, y in small[near].tolist()]
