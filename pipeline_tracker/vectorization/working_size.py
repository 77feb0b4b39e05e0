"""The size at which images are worked on: alike for all cameras."""

from __future__ import annotations

# Larger images are first shrunk by a whole factor to at most this width: the sea blurs more than
# that, and every later step is then alike for all cameras.
WORKING_WIDTH = 1600


def working_factor(width: int) -> int:
    """Return by which whole factor images of a width (px) are shrunk: px of theirs for one."""
    return max(1, -(-width // WORKING_WIDTH))
