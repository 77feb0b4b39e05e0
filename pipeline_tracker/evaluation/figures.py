"""The figures of a replay, computed from its frames; ``schema`` says what each is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from pipeline_tracker.evaluation.contour_error import LINES, LineResult
from pipeline_tracker.evaluation.frames import FrameResult
from pipeline_tracker.evaluation.replay import NUMBERS
from pipeline_tracker.evaluation.schema import (
    ContourFigures,
    Counts,
    Coverage,
    DivergenceFigures,
    FrameFigures,
    GroupFigures,
    MeanMax,
    SignedError,
    Spread,
)
from pipeline_tracker.evaluation.uncertainty import LEVELS, chi2_quantile

# Within so many sigma lie 95 % of a normal distribution.
_SIGMAS_95 = 1.96


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


def frame_figures(frames: Iterable[FrameResult]) -> list[FrameFigures]:
    """Return what is told of each frame."""
    return [_frame(f) for f in frames]


def _frame(f: FrameResult) -> FrameFigures:
    estimate, off, spread = f.estimate, f.divergence, f.uncertainty
    lines = f.contours or {}
    return FrameFigures(
        stamp_ns=estimate.stamp_ns,
        state=estimate.state,
        valid=estimate.valid,
        mode=estimate.mode,
        technique=estimate.technique,
        in_view=f.view.in_view,
        detectable=f.view.detectable,
        false_reasons=list(f.false_reasons),
        travelled=f.travelled,
        horizontal=None if off is None else off.horizontal,
        vertical=None if off is None else off.vertical,
        total=None if off is None else off.total,
        offsets=None if f.offsets is None else list(f.offsets),
        sigmas=None if spread is None else list(spread.sigmas),
        nees=None if spread is None else spread.nees,
        direction_nees=None if spread is None else spread.direction_nees,
        covered=None if spread is None or spread.nees is None else _covers(spread.nees),
        errors=f.errors,
        error_sigmas=f.error_sigmas,
        contours_px={k: x.error for k, x in lines.items() if x.error is not None},
        visible_contours_px={
            k: x.visible_error for k, x in lines.items() if x.visible_error is not None
        },
    )


def _covers(nees: float) -> bool:
    return nees <= chi2_quantile(0.95)


def _figures(frames: Iterable[FrameResult]) -> GroupFigures:
    measured = [(f, f.divergence) for f in frames if f.divergence is not None]
    spreads = [f.uncertainty for f, _ in measured if f.uncertainty is not None]
    return GroupFigures(
        frames=len(measured),
        divergence=DivergenceFigures(
            horizontal=_mean_max([d.horizontal for _, d in measured]),
            vertical=_mean_max([d.vertical for _, d in measured]),
            total=_mean_max([d.total for _, d in measured]),
        ),
        errors={name: _signed(name, [f for f, _ in measured]) for name in NUMBERS},
        coverage_95=_coverage([s.nees for s in spreads if s.nees is not None]),
        direction_coverage_95=_coverage(
            [s.direction_nees for s in spreads if s.direction_nees is not None]
        ),
        contours=_contours([f.contours for f, _ in measured if f.contours]),
    )


def _coverage(nees: list[float]) -> Coverage:
    shares = {
        f"{level:g}": _mean([float(value <= chi2_quantile(level / 100.0)) for value in nees])
        for level in LEVELS
    }
    return Coverage(frames=len(nees), share=shares["95"], levels=shares, nees_mean=_mean(nees))


def _contours(frames: list[dict[str, LineResult]]) -> dict[str, ContourFigures]:
    if not frames:
        return {}
    lines = {name: [f[name] for f in frames if name in f] for name in LINES}
    groups = {"all": [line for members in lines.values() for line in members], **lines}
    return {name: _contour(members) for name, members in groups.items() if members}


def _contour(lines: list[LineResult]) -> ContourFigures:
    errors = [line.error for line in lines if line.error is not None]
    visible = [line.visible_error for line in lines if line.visible_error is not None]
    known = all(line.missed is not None for line in lines)
    return ContourFigures(
        lines=sum(line.seen for line in lines),
        measured=len(errors),
        error_px=_spread(errors),
        ends_px=_spread([line.ends for line in lines if line.ends is not None]),
        worst_px=max((line.worst for line in lines if line.worst is not None), default=None),
        measured_visible=len(visible) if known else None,
        visible_error_px=_spread(visible) if known else None,
        contours_not_visible=sum(line.not_visible for line in lines),
        wrong_side=sum(line.wrong_side for line in lines),
        missed=sum(bool(line.missed) for line in lines) if known else None,
    )


def _spread(values: list[float]) -> Spread:
    if not values:
        return Spread(mean=None, median=None, p95=None, max=None)
    return Spread(
        mean=float(np.mean(values)),
        median=float(np.median(values)),
        p95=float(np.percentile(values, 95.0)),
        max=max(values),
    )


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _mean_max(values: list[float]) -> MeanMax:
    return MeanMax(mean=_mean(values), max=max(values, default=None))


def _signed(name: str, frames: Sequence[FrameResult]) -> SignedError:
    values = [f.errors[name] for f in frames if name in f.errors]
    within = [
        float(abs(f.errors[name]) <= _SIGMAS_95 * f.error_sigmas[name])
        for f in frames
        if name in f.errors and name in f.error_sigmas
    ]
    return SignedError(
        frames=len(values),
        mean=_mean(values),
        rms=math.sqrt(float(np.mean(np.square(values)))) if values else None,
        extreme=max(values, key=abs, default=None),
        in_95=_mean(within),
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
