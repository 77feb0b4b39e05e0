"""See that a truth belongs to a replay: the same stamps, cameras, images and navigation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.replay import Replay
from pipeline_tracker.evaluation.schema import Fit
from pipeline_tracker.evaluation.truth import Truth
from pipeline_tracker.geometry.camera import Camera
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.mounting import mounting_from_settings

# Mean difference of two thumbnails of one image, grey levels: JPEG decoders differ by a level here
# and there. Another sea differs by more, as does another frame of the same.
_SAME_IMAGE = 0.5
# The median step of a VNM is no further off the true one, m, share of the step, and rad; the step
# of another sea of the same kind is.
_STEP_OFF, _STEP_SHARE, _STEP_TURN = 0.02, 0.05, np.radians(1.5)
# The same pose, read twice; the same calibration, relative; m, rad or 1.
_SAME = 1e-6


def check_fit(replay: Replay, truth: Truth) -> Fit:
    """See that a truth belongs to a replay.

    Args:
        replay: the replay.
        truth: the truth.

    Returns:
        What was compared.

    Raises:
        EvaluationError: frames have no true pose, or the bag's cameras, images or VNM poses are
            not those replayed; or the mounting or the motion is another one and neither images
            nor poses could be compared.
    """
    _check_stamps(replay, truth)
    _check_cameras(replay, truth)
    images, poses = _compare_images(replay, truth), _compare_poses(replay, truth)
    offset = _mounting_offset(replay, truth)
    if offset is not None and max(offset) > _SAME and not images and not poses:
        raise _misfit(
            replay,
            truth,
            f"its camera is mounted {100.0 * offset[0]:.1f} cm and {np.degrees(offset[1]):.1f} "
            "degrees off the one replayed, and neither images nor poses say that it is the same "
            "bag",
        )
    steps = 0 if images or poses else _compare_motion(replay, truth)
    return Fit(
        images_compared=images,
        poses_compared=poses,
        steps_compared=steps,
        mounting_offset=None if offset is None else offset[0],
        mounting_angle=None if offset is None else offset[1],
    )


def _check_stamps(replay: Replay, truth: Truth) -> None:
    stamps = [estimate.stamp_ns for estimate in replay.estimates]
    missing = [stamp for stamp in stamps if truth.poses.at(stamp) is None]
    if missing:
        raise _misfit(
            replay,
            truth,
            f"{len(missing)} of its {len(stamps)} frames have no true pose (the first has the "
            f"stamp {missing[0]} ns)",
        )


def _check_cameras(replay: Replay, truth: Truth) -> None:
    if replay.rig is None or truth.recording.rig is None:
        return
    pairs = zip(replay.rig.cameras, truth.recording.rig.cameras, strict=False)
    for side, (seen, there) in zip(("left", "right"), pairs, strict=False):
        for name in _differing(seen, there):
            raise _misfit(
                replay,
                truth,
                f"its {side} camera is another one ({name} is {getattr(there, name):g}, "
                f"{getattr(seen, name):g} was replayed)",
            )


def _differing(one: Camera, other: Camera) -> Iterator[str]:
    for field in dataclasses.fields(Camera):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if abs(a - b) > _SAME * max(1.0, abs(a)):
            yield field.name


def _compare_images(replay: Replay, truth: Truth) -> int:
    there = truth.recording
    if there.images is None:
        return 0
    compared = 0
    for stamp, seen in replay.thumbnails.items():
        if stamp not in there.images:
            raise _misfit(replay, truth, f"it has no left image of stamp {stamp} ns")
        other = there.thumbnails.get(stamp)
        if other is None:
            continue
        if other.shape != seen.shape or _difference(other, seen) > _SAME_IMAGE:
            raise _misfit(replay, truth, f"its left image of stamp {stamp} ns is another one")
        compared += 1
    return compared


def _compare_poses(replay: Replay, truth: Truth) -> int:
    """Compare the poses that the replay took with those of the bag; return how many."""
    if truth.recording.poses is None:
        return 0
    pairs = [(pose, truth.recording.poses.at(stamp)) for stamp, pose in replay.poses.items()]
    known = [(pose, there) for pose, there in pairs if there is not None]
    others = sum(max(_apart(pose, there)) > _SAME for pose, there in known)
    # After a clock that jumped back a few poses are interpolated otherwise.
    if others > len(known) / 2.0:
        topic = replay.settings.topics.pose
        raise _misfit(
            replay,
            truth,
            f"{others} of {len(known)} poses of {topic} are other ones than those replayed",
        )
    return len(known)


def _compare_motion(replay: Replay, truth: Truth) -> int:
    """Compare the replay's motion from frame to frame with the true one; return how many steps."""
    known = [(pose, truth.poses.at(stamp)) for stamp, pose in sorted(replay.poses.items())]
    pairs = [(pose, true) for pose, true in known if true is not None]
    steps = []
    for (seen_before, true_before), (seen, true) in pairwise(pairs):
        moved = true_before.inverse() @ true
        off, turn = _apart(seen_before.inverse() @ seen, moved)
        allowed = _STEP_OFF + _STEP_SHARE * float(np.linalg.norm(moved.translation))
        steps.append(max(off / allowed, turn / _STEP_TURN))
    if steps and np.median(steps) > 1.0:
        raise _misfit(
            replay,
            truth,
            "it has neither the images nor the poses that were replayed, and the true motion is "
            "not the one that was replayed",
        )
    return len(steps)


def _mounting_offset(replay: Replay, truth: Truth) -> tuple[float, float] | None:
    """Return how far the mounting of the replay is off that of the bag, m and rad."""
    used, there = mounting_from_settings(replay.settings), truth.recording.mounting
    return None if used is None or there is None else _apart(used, there)


def _apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Return distance, m, and angle, rad, between two poses."""
    turn = one.rotation.T @ other.rotation
    # Of the skew part: small angles keep their digits.
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(np.linalg.norm(sine), np.trace(turn) - 1.0)
    return float(np.linalg.norm(one.translation - other.translation)), float(angle)


def _misfit(replay: Replay, truth: Truth, why: str) -> EvaluationError:
    return EvaluationError(
        f"{truth.path}: the truth does not fit the replay {replay.directory}: {why}; expected the "
        "bag that was replayed"
    )


def _difference(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    return float(np.abs(first.astype(np.int16) - second.astype(np.int16)).mean())
