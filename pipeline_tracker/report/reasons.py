"""Reasons of frames that are not valid, in words."""

from __future__ import annotations

_IN_WORDS = {
    "no_right_image": "no right image within sync.tolerance",
    "no_left_image": "no left image within sync.tolerance",
    "late": "came too late for its partner",
    "repeated": "the stamp was there before",
    "queue_full": "no right image, and too many left ones waited (sync.queue)",
    "pipe_not_found": "no pipe was found in the pictures",
    "no_pose": "without a pose",
    "no_pose, pipe_not_found": "no pipe was found in the pictures (nor was there a pose)",
}


def in_words(reason: str) -> str:
    """Return a reason, or several joined by commas, for a person."""
    if reason in _IN_WORDS:
        return _IN_WORDS[reason]
    return ", ".join(_IN_WORDS.get(part, part.replace("_", " ")) for part in reason.split(", "))


def count(number: int, what: str, plural: str = "s") -> str:
    """Return a number with its noun: ``1 frame``, ``2 frames``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}{plural}"
