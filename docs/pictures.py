"""Makes the pictures of docs/method.md from the demo bag: python docs/pictures.py"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.pipeline import Pipeline
from pipeline_tracker.recognition.contours import contour_candidates
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.resources import demo_bag
from pipeline_tracker.settings_io import load_settings
from pipeline_tracker.surface import triangulate

Picture = NDArray[np.uint8]

_FRAME = 6
_QUALITY = 82
_HERE = Path(__file__).parent


def _scaled(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    low, high = np.percentile(values, [2.0, 98.0])
    return np.clip(255.0 * (values - low) / max(high - low, 1e-9), 0.0, 255.0).astype(np.uint8)


def _grey(image: Picture) -> Picture:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def segments_picture(image: Picture, segments: NDArray[np.float32]) -> Picture:
    """Draw straight segments, the longer the brighter."""
    picture = _grey((image * 0.6).astype(np.uint8))
    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    colours = cv2.applyColorMap(_scaled(np.log(lengths)).reshape(-1, 1), cv2.COLORMAP_VIRIDIS)
    for (x1, y1, x2, y2), colour in zip(segments, colours[:, 0], strict=True):
        ends = ((round(float(x1)), round(float(y1))), (round(float(x2)), round(float(y2))))
        cv2.line(picture, *ends, [int(c) for c in colour], 1, cv2.LINE_AA)
    return picture


def matches_picture(image: Picture, matches: NDArray[np.float32], heights: Picture) -> Picture:
    """Draw matched points, coloured by how near they are."""
    picture = _grey((image * 0.6).astype(np.uint8))
    colours = cv2.applyColorMap(heights.reshape(-1, 1), cv2.COLORMAP_VIRIDIS)
    for (x, y), colour in zip(matches[:, :2], colours[:, 0], strict=True):
        centre = (round(float(x)), round(float(y)))
        cv2.circle(picture, centre, 3, [int(c) for c in colour], -1, cv2.LINE_AA)
    return picture


def lines_picture(image: Picture, lines: list[NDArray[np.float64]]) -> Picture:
    """Draw lines (a, b, c), the candidates of the contours, heaviest brightest."""
    picture = _grey((image * 0.6).astype(np.uint8))
    height, width = image.shape
    for rank, (a, b, c) in enumerate(lines):
        shade = max(80, 255 - 25 * rank)
        foot = -c * np.array([a, b])
        along = np.array([-b, a]) * (width + height)
        ends = [tuple(int(round(v)) for v in foot + sign * along) for sign in (-1.0, 1.0)]
        cv2.line(picture, ends[0], ends[1], (0, shade * 159 // 255, shade * 230 // 255), 2)
    return picture


def main() -> None:
    """Write the pictures beside the pages."""
    settings = load_settings(None, ["pipe.diameter=0.6"])
    with BagReader(demo_bag()) as reader:
        source = ReplayInput(reader, settings)
        pipeline = Pipeline(source.settings, source.mounting)
        poses: PoseBuffer = pipeline.poses
        for number, frame in enumerate(source.frames(poses, lambda: None, pipeline.echoes)):
            assert frame.rig is not None
            assert frame.left is not None
            done = pipeline.process(frame.stamp_ns, frame.rig, frame.left, frame.right)
            if number == _FRAME:
                break
    seen, left = done.vectorized, np.asarray(frame.left)
    near = -triangulate(seen.matches, frame.rig).points[:, 2]
    candidates = [line.line for line in contour_candidates(seen.left_segments, frame.rig.left)]
    pictures = {
        "segments": segments_picture(left, seen.left_segments),
        "contours": lines_picture(left, candidates),
        "matches": matches_picture(left, seen.matches, _scaled(near)),
    }
    for name, picture in pictures.items():
        file = _HERE / f"method_{name}.jpg"
        cv2.imwrite(str(file), picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


if __name__ == "__main__":
    main()
