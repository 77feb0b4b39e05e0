"""The message types of Foxglove's image annotations, for bags: they need no package of ROS.

Names and fields are those of foxglove_msgs; Foxglove reads the definition that is in the bag.
"""

from __future__ import annotations

from typing import Any

from rosbags.typesys import get_types_from_msg

IMAGE_ANNOTATIONS = "foxglove_msgs/msg/ImageAnnotations"

_DEFINITIONS = {
    "Color": """
        float64 r
        float64 g
        float64 b
        float64 a
        """,
    "Point2": """
        float64 x
        float64 y
        """,
    "CircleAnnotation": """
        builtin_interfaces/Time timestamp
        foxglove_msgs/Point2 position
        float64 diameter
        float64 thickness
        foxglove_msgs/Color fill_color
        foxglove_msgs/Color outline_color
        """,
    "PointsAnnotation": """
        builtin_interfaces/Time timestamp
        uint8 UNKNOWN=0
        uint8 POINTS=1
        uint8 LINE_LOOP=2
        uint8 LINE_STRIP=3
        uint8 LINE_LIST=4
        uint8 type
        foxglove_msgs/Point2[] points
        foxglove_msgs/Color outline_color
        foxglove_msgs/Color[] outline_colors
        foxglove_msgs/Color fill_color
        float64 thickness
        """,
    "TextAnnotation": """
        builtin_interfaces/Time timestamp
        foxglove_msgs/Point2 position
        string text
        float64 font_size
        foxglove_msgs/Color text_color
        foxglove_msgs/Color background_color
        """,
    "ImageAnnotations": """
        foxglove_msgs/CircleAnnotation[] circles
        foxglove_msgs/PointsAnnotation[] points
        foxglove_msgs/TextAnnotation[] texts
        """,
}


def foxglove_types() -> dict[str, Any]:
    """Return the types as a type store of rosbags takes them."""
    types: dict[str, Any] = {}
    for name, text in _DEFINITIONS.items():
        lines = "\n".join(line.strip() for line in text.strip().splitlines())
        types.update(get_types_from_msg(f"{lines}\n", f"foxglove_msgs/msg/{name}"))
    return types
