"""What ``evaluation.json`` holds: the models are its schema, each field with its meaning."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 1

_LINES = (
    "left_image_left, left_image_right, right_image_left, right_image_right; the last word is the "
    "side seen along travel"
)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MeanMax(_Model):
    """Mean and maximum of a measure over frames."""

    mean: float | None = Field(description="Mean; null without frames")
    max: float | None = Field(description="Maximum; null without frames")


class Spread(_Model):
    """A measure over frames; null without any."""

    mean: float | None = Field(description="Mean")
    median: float | None = Field(description="Median")
    p95: float | None = Field(description="95th percentile")
    max: float | None = Field(description="Maximum")


class SignedError(_Model):
    """Statistics of estimate less truth."""

    frames: int = Field(description="Frames that have both")
    mean: float | None = Field(description="Mean with sign")
    rms: float | None = Field(description="Root of the mean square")
    extreme: float | None = Field(description="The error of greatest magnitude, with sign")
    in_95: float | None = Field(
        description="Share of the frames with a known variance whose error is within 1.96 sigma; "
        "null without such (lateral_offset has no variance)"
    )


class DivergenceFigures(_Model):
    """The paper's measure: sum over the segment's two ends of the distance to the true axis, m."""

    horizontal: MeanMax = Field(description="Sum of the horizontal components, m")
    vertical: MeanMax = Field(description="Sum of the vertical components, m")
    total: MeanMax = Field(description="Sum of the distances, m")


class Coverage(_Model):
    """How honest two numbers of the covariance are (they and their correlation)."""

    frames: int = Field(description="Frames with a covariance")
    share: float | None = Field(description="Share of them whose 95 % region holds the truth")
    levels: dict[str, float | None] = Field(
        description="The same for the regions of 50, 80, 90, 95 and 99 %"
    )
    nees_mean: float | None = Field(
        description="Mean of the squared error in units of its covariance; 2 where the covariance "
        "is right, more where it is too small"
    )


class ContourFigures(_Model):
    """Published contour lines against the true contours.

    A line's error is the mean distance of its points (4 px apart) from the true contour of its
    side, taken where the line lies beside a part of the contour that is inside the image.
    """

    lines: int = Field(description="Lines published: bits of visible_contours that are set")
    measured: int = Field(
        description="Lines of which any lies beside the true contour inside the image"
    )
    error_px: Spread = Field(description="Error of the measured lines, px")
    ends_px: Spread = Field(
        description="Mean distance of the two ends of the measured part of each line, px: where "
        "the straight line through the ends of a bent contour is on it"
    )
    worst_px: float | None = Field(description="Greatest distance of any point of them, px")
    measured_visible: int | None = Field(
        description="Lines of which any lies beside a visible part; null where it is not known "
        "what is hidden"
    )
    visible_error_px: Spread | None = Field(
        description="Their error beside visible parts alone, px; null likewise"
    )
    contours_not_visible: int = Field(
        description="Lines published of a contour that is hidden or outside the image all along "
        "(where it is not known what is hidden: outside)"
    )
    wrong_side: int = Field(
        description="Lines that are nearer to the pipe's other contour than to that of their side"
    )
    missed: int | None = Field(
        description="Contours without a line of whose length in view at least a quarter is "
        "visible; null where it is not known what is hidden"
    )


class GroupFigures(_Model):
    """The figures of a group of frames."""

    frames: int = Field(description="Frames with a segment, measured against the true axis")
    divergence: DivergenceFigures = Field(description="The paper's measure")
    errors: dict[str, SignedError] = Field(
        description="Estimate less truth by column of estimates.csv: heading_misalignment, "
        "pitch_misalignment (rad), min_distance, lateral_offset (m), approach_speed (m/s)"
    )
    coverage_95: Coverage = Field(
        description="Of left and up (m) at the segment's middle: does the region hold the axis"
    )
    direction_coverage_95: Coverage = Field(description="Of heading and pitch of the segment")
    contours: dict[str, ContourFigures] = Field(
        description=f"all, and each line: {_LINES}; empty without result bag or cameras"
    )


class Counts(_Model):
    """Frames by what became of them; null where the truth does not tell."""

    frames: int = Field(description="Rows of estimates.csv")
    valid: int = Field(description="Rows with valid = 1")
    valid_share: float = Field(description="valid / frames")
    in_view: int | None = Field(description="Frames with any of the pipe inside an image")
    in_view_valid: int | None = Field(description="Of these, valid")
    detectable: int | None = Field(
        description="Frames in whose left image, of one contour's length in view, at least a "
        "quarter is not hidden; null where the bag has no contours to tell what is hidden"
    )
    detectable_valid: int | None = Field(description="Of these, valid")
    detectable_valid_share: float | None = Field(
        description="detectable_valid / detectable; null without detectable frames"
    )
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


class SearchFigures(_Model):
    """Searches for the pipe."""

    searches: int = Field(description="Number of searches")
    found: int = Field(description="Searches that ended with the pipe found")
    mean: float | None = Field(description="Mean length of those, frames; null without any")
    max: int | None = Field(description="Longest of those, frames; null without any")
    never_found: int = Field(
        description="Searches at whose end the pipe was out of sight, or the replay over"
    )
    never_found_frames: int = Field(description="Frames in those, all together")
    lengths: list[int] = Field(description="Lengths of the searches that found, in time order")


class Finding(_Model):
    """How many frames it takes to find the pipe.

    Only frames in which the pipe can be found count: detectable ones, or, where that is not known,
    those with the pipe in view. A run is a series of such frames without another between them. A
    frame finds the pipe if it is valid and not false valid. A search begins with each run, and
    within a run with the first frame that does not find the pipe after one that did. It ends with
    the next frame that finds it, or with the run. Its length is the number of frames before the
    one that finds: 0 if the first frame does.
    """

    basis: str = Field(description="What makes a frame count: detectable or in_view")
    runs: int = Field(description="Number of runs")
    to_find: SearchFigures = Field(description="Searches before the pipe was ever found")
    to_find_again: SearchFigures = Field(
        description="Searches after that: the pipe was lost, or came into sight again"
    )


class FrameFigures(_Model):
    """One frame, so that figures can be pooled over replays; null where there is none."""

    stamp_ns: int = Field(description="Stamp of the left image, ns")
    state: str = Field(description="State of the tracker; empty: never processed")
    valid: bool = Field(description="As estimates.csv has it")
    mode: str = Field(description="recognition or tracking; empty without a segment")
    technique: int | None = Field(description="0 tracking, 1 to 4 recognition")
    in_view: bool | None = Field(description="Any of the pipe is inside an image")
    detectable: bool | None = Field(description="See counts.detectable")
    false_reasons: list[str] = Field(description="Why a valid frame is false; else empty")
    travelled: float = Field(description="True way of the vehicle since the first frame, m")
    horizontal: float | None = Field(description="Divergence, sum of both ends, m")
    vertical: float | None = Field(description="Divergence, sum of both ends, m")
    total: float | None = Field(description="Divergence, sum of both ends, m")
    offsets: list[float] | None = Field(
        description="Segment less true axis at the segment's middle: left m, up m, heading rad, "
        "pitch rad, as the covariance of PipeSegment orders them"
    )
    sigmas: list[float] | None = Field(
        description="Standard deviations of these four by the published covariance"
    )
    nees: float | None = Field(description="Squared (left, up) in units of its covariance")
    direction_nees: float | None = Field(description="Squared (heading, pitch), likewise")
    covered: bool | None = Field(description="nees is inside the 95 % region, at most 5.991")
    errors: dict[str, float] = Field(description="Estimate less truth by column, see groups")
    error_sigmas: dict[str, float] = Field(
        description="Standard deviations of these by the relative state, where known"
    )
    contours_px: dict[str, float] = Field(description=f"Error of each measured line: {_LINES}")
    visible_contours_px: dict[str, float] = Field(
        description="The same beside visible parts alone; empty where not known"
    )


class Fit(_Model):
    """What says that the truth belongs to the replay; all 0: nothing but stamps could be seen."""

    images_compared: int = Field(
        description="Frames whose image in the truth's bag was seen to be the one replayed"
    )
    poses_compared: int = Field(
        description="Frames whose VNM pose in the truth's bag was seen to be the one replayed"
    )
    steps_compared: int = Field(
        description="Steps from frame to frame whose true motion was seen to be that of the VNM, "
        "about; looked at where neither images nor poses can be compared, else 0"
    )
    mounting_offset: float | None = Field(
        description="Distance of the camera's place in the replay from that in the bag, m; null "
        "where one is not known. Errors of a wrong mounting are errors of the estimates"
    )
    mounting_angle: float | None = Field(description="Angle between the two, rad; null likewise")


class Setup(_Model):
    """What the figures were made with; null where not known."""

    pipe_diameter: float = Field(description="As the replay was told, m")
    true_pipe_diameter: float | None = Field(
        description="As the scenario of a simulated bag has it, m; else that of the replay is "
        "taken for true"
    )
    technique: str = Field(description="recognition.technique of the replay")
    recognition_only: bool = Field(description="Each frame by itself, no tracking")
    image_size: list[int] | None = Field(description="Width and height, px")
    field_of_view: float | None = Field(description="Horizontal, rad")
    baseline: float | None = Field(description="m; 0 in mono")
    mounting_translation: list[float] | None = Field(
        description="True place of the left optical frame in base_link, m"
    )
    mounting_rpy: list[float] | None = Field(description="Its roll, pitch and yaw, rad")
    scenario: dict[str, Any] | None = Field(
        description="The scenario of a simulated bag, with lamps, water and all else"
    )


class Evaluation(_Model):
    """A replay measured against the truth."""

    schema_version: int = Field(default=SCHEMA_VERSION, description="Version of this schema")
    replay: str = Field(description="The replay's directory")
    truth: str = Field(description="The bag with the truth")
    fit: Fit = Field(description="What says that the truth belongs to the replay")
    setup: Setup = Field(description="What the figures were made with")
    counts: Counts = Field(description="Frames by what became of them")
    finding: Finding | None = Field(
        description="null where neither detectable nor in_view is known of all frames"
    )
    groups: dict[str, GroupFigures] = Field(
        description="all: valid frames; tracking, recognition: those by mode; technique_1 to "
        "technique_4: recognitions by technique; coasting: not valid, carried on by the pose. "
        "Only groups that have frames, and all"
    )
    per_frame: list[FrameFigures] = Field(description="Each row of estimates.csv, in its order")


def evaluation_schema() -> dict[str, Any]:
    """Return the JSON Schema of ``evaluation.json``."""
    return Evaluation.model_json_schema()
