"""The figures of a replay: what ``evaluation.json`` holds.

The models are the schema: ``evaluation_schema()`` gives it as JSON Schema, with each description.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline_tracker.evaluation.frames import FrameResult
from pipeline_tracker.evaluation.replay import NUMBERS

SCHEMA_VERSION = 1


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MeanMax(_Model):
    """Mean and maximum of a measure over frames."""

    mean: float | None = Field(description="Mean; null without frames")
    max: float | None = Field(description="Maximum; null without frames")


class SignedError(_Model):
    """Statistics of estimate less truth."""

    frames: int = Field(description="Frames that have both")
    mean: float | None = Field(description="Mean with sign")
    rms: float | None = Field(description="Root of the mean square")
    extreme: float | None = Field(description="The error of greatest magnitude, with sign")


class DivergenceFigures(_Model):
    """The paper's measure: sum over the segment's two ends of the distance to the true axis, m."""

    horizontal: MeanMax = Field(description="Sum of the horizontal components, m")
    vertical: MeanMax = Field(description="Sum of the vertical components, m")
    total: MeanMax = Field(description="Sum of the distances, m")


class Coverage(_Model):
    """How honest the covariance is."""

    frames: int = Field(description="Frames with a covariance")
    share: float | None = Field(
        description="Share of them whose 95 % region of (left, up) at the segment's middle holds "
        "the true axis"
    )


class GroupFigures(_Model):
    """The figures of a group of frames."""

    frames: int = Field(description="Frames with a segment, measured against the true axis")
    divergence: DivergenceFigures
    errors: dict[str, SignedError] = Field(
        description="Estimate less truth by column of estimates.csv: heading_misalignment, "
        "pitch_misalignment (rad), min_distance, lateral_offset (m), approach_speed (m/s)"
    )
    coverage_95: Coverage


class Counts(_Model):
    """Frames by what became of them; null where the truth does not tell."""

    frames: int = Field(description="Rows of estimates.csv")
    valid: int
    valid_share: float
    in_view: int | None = Field(description="Frames with any of the pipe inside an image")
    in_view_valid: int | None
    detectable: int | None = Field(
        description="Frames in whose left image, of one contour's length in view, at least a "
        "quarter is not hidden; null where the bag has no contours to tell what is hidden"
    )
    detectable_valid: int | None
    detectable_valid_share: float | None = Field(description="null without detectable frames")
    false_valid: int = Field(
        description="Valid frames with no pipe in view, or an end off by more than 5 cm (10 cm "
        "beyond 3 m of distance), or the direction by more than 3 degrees"
    )
    false_valid_reasons: dict[str, int] = Field(
        description="By reason: no_pipe_in_view, end, direction; a frame may have several"
    )
    false_valid_stamps: list[int] = Field(description="Their stamps, ns")
    states: dict[str, int] = Field(
        description="Frames by the state of the tracker; lost: never processed"
    )


class Evaluation(_Model):
    """A replay measured against the truth."""

    schema_version: int = SCHEMA_VERSION
    replay: str = Field(description="The replay's directory")
    truth: str = Field(description="The bag with the truth")
    images_compared: int = Field(
        description="Frames whose image in the truth's bag was seen to be the one replayed"
    )
    counts: Counts
    groups: dict[str, GroupFigures] = Field(
        description="all: valid frames; tracking, recognition: those by mode; technique_1 to "
        "technique_4: recognitions by technique; coasting: not valid, carried on by the pose. "
        "Only groups that have frames, and all"
    )


def evaluation_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``evaluation.json``."""
    return Evaluation.model_json_schema()


def count(frames: Sequence[FrameResult]) -> Counts:
    """Count frames by what became of them."""
    valid = [f for f in frames if f.estimate.valid]
    false = [f for f in valid if f.false_reasons]
    reasons = [reason for f in false for reason in f.false_reasons]
    states = [f.estimate.state or "lost" for f in frames]
    in_view = _known(frames, lambda f: f.view.in_view)
    detectable = _known(frames, lambda f: f.view.detectable)
    found = None if detectable is None else _valid(detectable)
    return Counts(
        frames=len(frames),
        valid=len(valid),
        valid_share=len(valid) / len(frames),
        in_view=None if in_view is None else len(in_view),
        in_view_valid=None if in_view is None else _valid(in_view),
        detectable=None if detectable is None else len(detectable),
        detectable_valid=found,
        detectable_valid_share=found / len(detectable)
        if found is not None and detectable
        else None,
        false_valid=len(false),
        false_valid_reasons={reason: reasons.count(reason) for reason in sorted(set(reasons))},
        false_valid_stamps=[f.estimate.stamp_ns for f in false],
        states={state: states.count(state) for state in sorted(set(states))},
    )


def group_figures(frames: Sequence[FrameResult]) -> dict[str, GroupFigures]:
    """Compute the figures of each group that has frames, and of all valid ones."""
    valid = [f for f in frames if f.estimate.valid]
    groups = {
        "all": valid,
        "tracking": [f for f in valid if f.estimate.mode == "tracking"],
        "recognition": [f for f in valid if f.estimate.mode == "recognition"],
    }
    for number in (1, 2, 3, 4):
        groups[f"technique_{number}"] = [
            f for f in groups["recognition"] if f.estimate.technique == number
        ]
    groups["coasting"] = [f for f in frames if f.estimate.state == "coasting"]
    return {
        name: _figures(members)
        for name, members in groups.items()
        if name == "all" or any(f.divergence is not None for f in members)
    }


def _figures(frames: Iterable[FrameResult]) -> GroupFigures:
    measured = [(f, f.divergence) for f in frames if f.divergence is not None]
    covered = [f.covered for f, _ in measured if f.covered is not None]
    return GroupFigures(
        frames=len(measured),
        divergence=DivergenceFigures(
            horizontal=_mean_max([d.horizontal for _, d in measured]),
            vertical=_mean_max([d.vertical for _, d in measured]),
            total=_mean_max([d.total for _, d in measured]),
        ),
        errors={
            name: _signed([f.errors[name] for f, _ in measured if name in f.errors])
            for name in NUMBERS
        },
        coverage_95=Coverage(
            frames=len(covered), share=float(np.mean(covered)) if covered else None
        ),
    )


def _mean_max(values: list[float]) -> MeanMax:
    if not values:
        return MeanMax(mean=None, max=None)
    return MeanMax(mean=float(np.mean(values)), max=float(np.max(values)))


def _signed(values: list[float]) -> SignedError:
    if not values:
        return SignedError(frames=0, mean=None, rms=None, extreme=None)
    return SignedError(
        frames=len(values),
        mean=float(np.mean(values)),
        rms=float(np.sqrt(np.mean(np.square(values)))),
        extreme=max(values, key=abs),
    )


def _valid(frames: Sequence[FrameResult]) -> int:
    return sum(f.estimate.valid for f in frames)


def _known(
    frames: Sequence[FrameResult], of: Callable[[FrameResult], bool | None]
) -> list[FrameResult] | None:
    """Return the frames of which something is true; None where it is not known of all."""
    if any(of(f) is None for f in frames):
        return None
    return [f for f in frames if of(f)]
