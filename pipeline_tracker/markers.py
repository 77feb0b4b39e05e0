"""What is shown of the pipe in RViz and Foxglove: the centreline so far, and markers."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    MessageFactory,
    header_message,
    point_message,
    pose_message,
)
from pipeline_tracker.types import PipeSegment, RelativeState, State, TrackingStatus

Array = NDArray[np.float64]

_ADD, _DELETE_ALL = 0, 3
_ARROW, _SPHERE, _CYLINDER = 0, 2, 3
# Blue and orange: told apart by colour-blind eyes too.
_TRACKING_COLOUR = (0.0, 0.45, 0.70, 0.9)
_COASTING_COLOUR = (0.90, 0.62, 0.0, 0.6)


class Centerline:
    """The newest stretch of the pipe's centreline in odom, with bounded memory.

    A point is the middle of a valid segment; a new one is kept once it lies ``spacing`` further.
    """

    def __init__(self, spacing: float = 0.25, length: int = 200) -> None:
        """Keep at most ``length`` points, ``spacing`` metres apart or more."""
        self._spacing = spacing
        self._poses: deque[Pose] = deque(maxlen=length)
        # Made once for each point: the whole line is sent again with every new one.
        self._messages: deque[Any] = deque(maxlen=length)
        self._factory: MessageFactory | None = None
        self._fresh = 0
        self._reset_counter: int | None = None

    def update(self, state: RelativeState, segment: PipeSegment | None, pose: Pose | None) -> bool:
        """Take in a frame.

        Args:
            state: the frame's relative state; only valid ones add a point, and another
                ``reset_counter`` forgets those before.
            segment: the frame's segment in base_link.
            pose: odom <- base_link at its stamp; None without.

        Returns:
            Whether a point was added.
        """
        if state.reset_counter != self._reset_counter:
            self._poses.clear()
            self._messages.clear()
            self._fresh = 0
            self._reset_counter = state.reset_counter
        if not state.valid or segment is None or pose is None:
            return False
        start, end = pose.apply(segment.start), pose.apply(segment.end)
        middle = (start + end) / 2.0
        if self._poses:
            moved = float(np.linalg.norm(middle - self._poses[-1].translation))
            if moved < self._spacing:
                return False
        self._poses.append(Pose(_along(end - start, axis=0), middle))
        self._fresh = min(self._fresh + 1, len(self._poses))
        return True

    def message(self, factory: MessageFactory, nanoseconds: int, odom: str) -> Any:
        """Return nav_msgs/Path in odom; each pose's x axis runs along the pipe."""
        header = header_message(factory, nanoseconds, odom)
        if factory is not self._factory:
            self._factory = factory
            self._messages.clear()
            self._fresh = len(self._poses)
        fresh = [self._poses[i] for i in range(-self._fresh, 0)]
        self._messages.extend(pose_message(factory, pose) for pose in fresh)
        self._fresh = 0
        poses = [
            factory.message("geometry_msgs/msg/PoseStamped", header=header, pose=pose)
            for pose in self._messages
        ]
        return factory.message("nav_msgs/msg/Path", header=header, poses=poses)


def markers_message(
    factory: MessageFactory,
    status: TrackingStatus,
    segment: PipeSegment | None,
    state: RelativeState,
    base_link: str,
) -> Any:
    """Return visualization_msgs/MarkerArray of a frame in base_link.

    The cylinder of the segment, an arrow along it and its upper point; without a segment, one
    marker that deletes them.
    """
    header = header_message(factory, status.stamp_ns, base_link)
    if segment is None or status.state == State.SEARCHING:
        gone = _marker(factory, header, 0, _SPHERE, Pose.identity(), (0, 0, 0), (0, 0, 0, 0))
        gone.action = _DELETE_ALL
        return factory.message("visualization_msgs/msg/MarkerArray", markers=[gone])
    colour = _TRACKING_COLOUR if state.valid else _COASTING_COLOUR
    along = segment.end - segment.start
    length = float(np.linalg.norm(along))
    middle = (segment.start + segment.end) / 2.0
    width = 2.0 * segment.radius
    cylinder = _marker(
        factory,
        header,
        0,
        _CYLINDER,
        Pose(_along(along, axis=2), middle),
        (width, width, length),
        colour,
    )
    arrow = _marker(
        factory, header, 1, _ARROW, Pose.identity(), (0.05, 0.1, 0.1), (1.0, 1.0, 1.0, 1.0)
    )
    arrow.points = [point_message(factory, segment.start), point_message(factory, segment.end)]
    markers = [cylinder, arrow]
    if np.any(state.upper_point):
        top = Pose(np.eye(3), state.upper_point)
        markers.append(_marker(factory, header, 2, _SPHERE, top, (0.08, 0.08, 0.08), colour))
    return factory.message("visualization_msgs/msg/MarkerArray", markers=markers)


def _marker(
    factory: MessageFactory,
    header: Any,
    number: int,
    kind: int,
    pose: Pose,
    scale: tuple[float, float, float],
    colour: tuple[float, float, float, float],
) -> Any:
    x, y, z = (float(v) for v in scale)
    r, g, b, a = (float(v) for v in colour)
    return factory.message(
        "visualization_msgs/msg/Marker",
        header=header,
        ns="pipeline",
        id=number,
        type=kind,
        action=_ADD,
        pose=pose_message(factory, pose),
        scale=factory.message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        color=factory.message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a),
    )


def _along(direction: Array, axis: int) -> Array:
    """Return a rotation whose column ``axis`` points along ``direction``."""
    first = direction / np.linalg.norm(direction)
    helper = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = np.cross(helper, first)
    second /= np.linalg.norm(second)
    columns = np.stack((first, second, np.cross(first, second)), axis=1)
    return np.roll(columns, axis, axis=1)
