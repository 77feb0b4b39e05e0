"""How honest the published covariances are, over all frames of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.benchmark.plan import Plan
from pipeline_tracker.benchmark.results import read_run
from pipeline_tracker.evaluation.plots import draw_calibration, save_figure
from pipeline_tracker.evaluation.schema import FrameFigures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

CALIBRATION = "calibration_{variant}.png"
_BINS = np.linspace(-5.0, 5.0, 41)
_PARTS = (("left", "up"), ("heading", "pitch"))
_COLOURS = ("#0072B2", "#E69F00")


def valid_frames(plan: Plan, root: Path) -> dict[str, list[FrameFigures]]:
    """Collect the valid frames of all runs that are done, by variant.

    Args:
        plan: the plan.
        root: the benchmark's directory.
    """
    found: dict[str, list[FrameFigures]] = {}
    for run in plan.runs:
        result = read_run(root / run.directory)
        if result is not None:
            frames = [f for f in result.evaluation.per_frame if f.valid and f.sigmas]
            found.setdefault(run.variant, []).extend(frames)
    return {variant: frames for variant, frames in found.items() if frames}


def write_calibration(frames: Mapping[str, Sequence[FrameFigures]], root: Path) -> list[Path]:
    """Draw for each variant how often the truth is in the region that is published.

    Args:
        frames: its valid frames, by variant.
        root: where to write a file for each.

    Returns:
        The files.

    Raises:
        EvaluationError: one cannot be written.
    """
    written = []
    for variant, own in frames.items():
        path = root / CALIBRATION.format(variant=variant)
        save_figure(path, partial(_draw, frames=own, variant=variant))
        written.append(path)
    return written


def _draw(figure: Figure, frames: Sequence[FrameFigures], variant: str) -> None:
    """Coverage above, standardized errors below; place at the left, direction at the right."""
    figure.set_size_inches(9.0, 9.0)
    rows: Any = figure.subplots(2, 2, height_ratios=[3.0, 2.0])
    nees = ([f.nees for f in frames], [f.direction_nees for f in frames])
    for column, names in enumerate(_PARTS):
        known = np.array([value for value in nees[column] if value is not None])
        draw_calibration(rows[0, column], " and ".join(names), known)
        _draw_errors(rows[1, column], frames, 2 * column, names)
    rows[0, 0].set_ylabel("share of truths inside the region")
    rows[1, 0].set_ylabel("share of frames for each sigma")
    figure.suptitle(f"Published covariance, {len(frames)} valid frames, variant {variant}")


def _draw_errors(
    axes: Axes, frames: Sequence[FrameFigures], first: int, names: Sequence[str]
) -> None:
    """Draw errors in units of their sigma beside the normal that they should follow."""
    places = np.linspace(_BINS[0], _BINS[-1], 200)
    normal = np.exp(-0.5 * places**2) / np.sqrt(2.0 * np.pi)
    axes.plot(places, normal, color="#000000", linewidth=0.8, linestyle="--", label="honest")
    for number, (name, colour) in enumerate(zip(names, _COLOURS, strict=True), start=first):
        errors = np.array([_in_sigmas(f, number) for f in frames])
        axes.hist(
            np.clip(errors, _BINS[0], _BINS[-1]),
            bins=_BINS.tolist(),
            density=True,
            histtype="step",
            color=colour,
            linewidth=1.5,
            label=f"{name}: mean {errors.mean():+.2f}, rms {np.sqrt(np.mean(errors**2)):.2f}",
        )
    axes.set_xlabel("error / sigma (beyond 5 at the border)")
    axes.legend(loc="upper left", fontsize=8)


def _in_sigmas(figures: FrameFigures, number: int) -> float:
    assert figures.offsets is not None  # noqa: S101 - frames with sigmas have errors
    assert figures.sigmas is not None  # noqa: S101 - the others were left out
    return figures.offsets[number] / figures.sigmas[number]
