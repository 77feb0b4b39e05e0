"""On which side of the pipe the vehicle is (4.1.3, 4.3)."""

from __future__ import annotations

from pipeline_tracker.types import Contours, Side

# In pipe radii. Within one radius the vehicle is above the pipe's own width. The quarter more that
# it takes to leave it (7 cm for a 0.6 m pipe) is wider than what an estimate wavers by.
RETURN_BELOW = 1.0
LEAVE_ABOVE = 1.25

_MIRRORED = {
    Side.LEFT_OF_PIPE: Side.RIGHT_OF_PIPE,
    Side.RIGHT_OF_PIPE: Side.LEFT_OF_PIPE,
    Side.ALONG: Side.ALONG,
    Side.NOT_IN_VIEW: Side.NOT_IN_VIEW,
}


def side_from_offset(lateral: float, radius: float, previous: Side = Side.NOT_IN_VIEW) -> Side:
    """Judge the side by the lateral offset, with hysteresis.

    Args:
        lateral: lateral offset, m, positive with the vehicle to port of the pipe.
        radius: the pipe's radius, m.
        previous: the side in the frame before; NOT_IN_VIEW where there was none.

    Returns:
        ALONG, LEFT_OF_PIPE or RIGHT_OF_PIPE.
    """
    outward = Side.LEFT_OF_PIPE if lateral > 0.0 else Side.RIGHT_OF_PIPE
    # Who was above the pipe, or on its other side, has the wider border to cross.
    fresh = previous in (Side.NOT_IN_VIEW, outward)
    border = radius * (RETURN_BELOW if fresh else LEAVE_ABOVE)
    return outward if abs(lateral) > border else Side.ALONG


def side_from_contours(contours: Contours) -> Side:
    """Judge the side by the contours that are seen, where no axis is known (4.1.3).

    A vehicle that sees only the pipe's left boundary has the rest of it beyond the right border of
    its picture, and so is left of the pipe.

    Args:
        contours: the visible contours; left and right as seen along travel.

    Returns:
        LEFT_OF_PIPE, RIGHT_OF_PIPE, ALONG where both boundaries are seen, NOT_IN_VIEW without any.
    """
    left = bool(contours & (Contours.LEFT_IMAGE_LEFT | Contours.RIGHT_IMAGE_LEFT))
    right = bool(contours & (Contours.LEFT_IMAGE_RIGHT | Contours.RIGHT_IMAGE_RIGHT))
    if left and right:
        return Side.ALONG
    if left:
        return Side.LEFT_OF_PIPE
    return Side.RIGHT_OF_PIPE if right else Side.NOT_IN_VIEW


def mirrored(side: Side) -> Side:
    """Return the side as it is called once the direction of travel is turned."""
    return _MIRRORED[side]
