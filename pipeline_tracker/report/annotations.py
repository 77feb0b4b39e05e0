"""What is drawn on a frame's left image, as Foxglove's image annotations."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.foxglove import IMAGE_ANNOTATIONS
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import MessageFactory, time_message
from pipeline_tracker.report.caption import caption
from pipeline_tracker.report.shapes import ContourShape, FrameShapes, frame_shapes
from pipeline_tracker.types import PipeSegment, RelativeState, TrackingStatus

Array = NDArray[np.float64]
_Colour = tuple[float, float, float, float]

# Those of the overlay pictures: told apart by colour-blind eyes too.
_LEFT_CONTOUR: _Colour = (0.902, 0.624, 0.0, 1.0)
_RIGHT_CONTOUR: _Colour = (0.337, 0.706, 0.914, 1.0)
_AXIS: _Colour = (0.941, 0.894, 0.259, 1.0)
_TEXT: _Colour = (1.0, 1.0, 1.0, 1.0)
_BEHIND_TEXT: _Colour = (0.0, 0.0, 0.0, 0.6)
_NONE: _Colour = (0.0, 0.0, 0.0, 0.0)
_BAND_ALPHA = 0.35
_EXPECTED_ALPHA = 0.6
_LINE_LOOP, _LINE_STRIP = 2, 3
# Length of the arrow's head in that of the axis piece, and its opening.
_HEAD = 0.15
# At an image 1200 px wide; scales with it.
_FONT, _MARGIN, _THICKNESS = 22.0, 12.0, 3.0


def annotations_message(
    factory: MessageFactory,
    camera: Camera,
    mounting: Pose,
    status: TrackingStatus,
    segment: PipeSegment | None,
    state: RelativeState,
) -> Any:
    """Return foxglove_msgs/ImageAnnotations of a frame's left image.

    The contours that were found (strong), where the others are expected (weak), the band in which
    they lie with 95 %, the axis piece with an arrow ahead, and the numbers.

    Args:
        factory: knows the type.
        camera: the left camera; the annotations are in its pixels.
        mounting: base_link <- left optical frame.
        status, segment, state: what the tracker and the estimator said.
    """
    painter = _Painter(factory, status.stamp_ns, camera.width / 1200.0)
    points: list[Any] = []
    if segment is not None:
        points = list(_shapes(painter, frame_shapes(segment, camera, 0, mounting)))
    return factory.message(
        IMAGE_ANNOTATIONS,
        circles=[],
        points=points,
        texts=painter.text(caption(status, segment, state)),
    )


def _shapes(painter: _Painter, shapes: FrameShapes) -> Iterable[Any]:
    for contour in shapes.contours:
        yield from _contour(painter, contour)
    if shapes.axis is not None:
        yield painter.line(_arrow(shapes.axis), _AXIS, _LINE_STRIP)


def _contour(painter: _Painter, contour: ContourShape) -> Iterable[Any]:
    colour = _LEFT_CONTOUR if contour.is_left else _RIGHT_CONTOUR
    if contour.band is not None and np.isfinite(contour.band).all():
        yield painter.area(contour.band, (*colour[:3], _BAND_ALPHA))
    if contour.seen is not None:
        yield painter.line(contour.seen, colour, _LINE_STRIP)
    elif contour.expected is not None:
        yield painter.line(contour.expected, (*colour[:3], _EXPECTED_ALPHA), _LINE_STRIP, 0.4)


def _arrow(axis: Array) -> Array:
    """Return the axis piece (2, 2) and its head as one line (5, 2)."""
    back = _HEAD * (axis[0] - axis[1])
    aside = np.array([-back[1], back[0]])
    return np.stack((axis[0], axis[1], axis[1] + back + aside, axis[1], axis[1] + back - aside))


class _Painter:
    """Makes annotations of one frame."""

    def __init__(self, factory: MessageFactory, stamp_ns: int, scale: float) -> None:
        self._factory = factory
        self._time = time_message(factory, stamp_ns)
        self._scale = scale

    def line(self, points: Array, colour: _Colour, kind: int, weight: float = 1.0) -> Any:
        return self._points(points, kind, colour, _NONE, weight * _THICKNESS * self._scale)

    def area(self, points: Array, colour: _Colour) -> Any:
        return self._points(points, _LINE_LOOP, _NONE, colour, 0.0)

    def text(self, lines: list[str]) -> list[Any]:
        size, margin = _FONT * self._scale, _MARGIN * self._scale
        return [
            self._factory.message(
                "foxglove_msgs/msg/TextAnnotation",
                timestamp=self._time,
                position=self._point(margin, margin + 1.6 * size * number),
                text=words,
                font_size=size,
                text_color=self._colour(_TEXT),
                background_color=self._colour(_BEHIND_TEXT),
            )
            for number, words in enumerate(lines, start=1)
        ]

    def _points(
        self, points: Array, kind: int, outline: _Colour, fill: _Colour, thickness: float
    ) -> Any:
        # Foxglove counts from the corner of the first pixel, we from its centre.
        return self._factory.message(
            "foxglove_msgs/msg/PointsAnnotation",
            timestamp=self._time,
            type=kind,
            points=[self._point(float(x) + 0.5, float(y) + 0.5) for x, y in points],
            outline_color=self._colour(outline),
            outline_colors=[],
            fill_color=self._colour(fill),
            thickness=thickness,
        )

    def _point(self, x: float, y: float) -> Any:
        return self._factory.message("foxglove_msgs/msg/Point2", x=x, y=y)

    def _colour(self, colour: _Colour) -> Any:
        r, g, b, a = colour
        return self._factory.message("foxglove_msgs/msg/Color", r=r, g=g, b=b, a=a)
