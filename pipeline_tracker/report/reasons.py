"""Reasons of frames that are not valid, in words."""

from __future__ import annotations

_IN_WORDS = {
    "no_right_image": "no right image within sync.tolerance",
    "no_left_image": "no left image within sync.tolerance",
    "late": "came too late for its partner",
    "repeated": "the stamp was there before",
    "queue_full": "no right image, and too many left ones waited (sync.queue)",
    "pipe_not_found": "no pipe was found in the pictures",
    "surface_not_a_pipe": "the surface there is that of the bed",
    "too_little_contour": "too little of the contours was seen",
    "one_contour_only": "one contour alone was seen",
    "cameras_disagree": "the two cameras do not agree",
    "too_little_support": "too little was found of what a pipe there would show",
    "too_uncertain": "found, but not well enough to steer by",
    "contours_not_clear": "several edges could be the contour",
    "fit_went_astray": "the fit went astray",
    "pose_jump": "the pose jumped as no vehicle can",
    "no_pose": "without a pose",
    "no_pose, pipe_not_found": "no pipe was found in the pictures (nor was there a pose)",
}


def in_words(reason: str) -> str:
    """Return a reason, or several joined by commas, for a person."""
    return ", ".join(_IN_WORDS.get(part, part.replace("_", " ")) for part in parts_of(reason))


def parts_of(reason: str) -> list[str]:
    """Return the reasons that are joined by commas, those that tell one thing together as one."""
    return [reason] if reason in _IN_WORDS else reason.split(", ")


def count(number: int, what: str, plural: str = "s") -> str:
    """Return a number with its noun: ``1 frame``, ``2 frames``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}{plural}"
