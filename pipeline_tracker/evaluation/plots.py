"""Plots of an evaluation: errors along the track, coverage, states.

Colours are those of Okabe and Ito, which colour-blind eyes tell apart; what they say is said by
place or shape too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from pipeline_tracker.errors import EvaluationError
from pipeline_tracker.evaluation.schema import Evaluation, FrameFigures
from pipeline_tracker.evaluation.uncertainty import chi2_quantile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ERRORS, COVERAGE, STATES = (f"evaluation_{n}.png" for n in ("errors", "coverage", "states"))
PLOTS = (ERRORS, COVERAGE, STATES)

_BLACK, _ORANGE, _SKY, _GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
_BLUE, _VERMILION, _GREY = "#0072B2", "#D55E00", "#BBBBBB"
_STATES = {"tracking": _GREEN, "coasting": _ORANGE, "searching": _VERMILION, "": _GREY}
_SIGMAS = 1.96
_SECOND = 1e9
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E5E5E5",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


def write_plots(evaluation: Evaluation, directory: Path) -> list[Path]:
    """Write the plots as PNG.

    Args:
        evaluation: what to show.
        directory: where to write ``PLOTS``.

    Returns:
        The files.

    Raises:
        EvaluationError: one cannot be written.
    """
    written = []
    for name, draw in ((ERRORS, draw_errors), (COVERAGE, draw_coverage), (STATES, draw_states)):
        save_figure(directory / name, partial(draw, evaluation))
        written.append(directory / name)
    return written


def save_figure(path: Path, draw: Callable[[Figure], None]) -> None:
    """Draw a figure in the style of all plots and write it as PNG.

    Args:
        path: the file.
        draw: draws into an empty figure.

    Raises:
        EvaluationError: it cannot be written.
    """
    import matplotlib as mpl  # noqa: PLC0415 - slow to import, and needed here alone
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    with mpl.rc_context(_STYLE):
        figure = Figure(layout="constrained", dpi=120)
        FigureCanvasAgg(figure)
        draw(figure)
        try:
            figure.savefig(path, metadata={"Software": None})
        except OSError as error:
            raise EvaluationError(f"{path}: cannot be written ({error.strerror})") from None


def draw_errors(evaluation: Evaluation, figure: Figure) -> None:
    """Draw errors along the track, with the band that the covariance promises."""
    figure.set_size_inches(9.0, 7.5)
    rows: Any = figure.subplots(4, 1, sharex=True)
    frames = evaluation.per_frame
    way = np.array([f.travelled for f in frames])
    if not way[-1] > 0.0:
        # Nothing moved: one frame after the other.
        way = np.arange(len(frames), dtype=np.float64)
    for axes in rows:
        _shade_invalid(axes, frames, way)
        axes.axhline(0.0, color=_BLACK, linewidth=0.6)
        if all(f.offsets is None for f in frames):
            _say_nothing(axes, "no frame with an estimate and a pipe")
    _draw_divergence(rows[0], frames, way)
    for axes, index, name in ((rows[1], 0, "left, cm"), (rows[2], 1, "up, cm")):
        _draw_offset(axes, frames, way, index, 100.0)
        axes.set_ylabel(f"error {name}")
    _draw_offset(rows[3], frames, way, 2, float(np.degrees(1.0)))
    rows[3].set_ylabel("error heading, deg")
    rows[3].set_xlabel("way of the vehicle, m" if frames[-1].travelled > 0.0 else "frame")
    figure.suptitle("Error of the segment along the track")
    handles = {
        label: handle
        for axes in rows
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4)


def _draw_divergence(axes: Axes, frames: Sequence[FrameFigures], way: Array) -> None:
    valid = np.array([f.valid for f in frames])
    for name, colour, marker in (("horizontal", _BLUE, "o"), ("vertical", _ORANGE, "s")):
        values = _scaled([getattr(f, name) for f in frames], 100.0)
        axes.plot(
            way,
            np.where(valid, values, np.nan),
            color=colour,
            marker=marker,
            markersize=3.5,
            linewidth=1.0,
            label=f"divergence, {name}",
        )
        _draw_carried(axes, way, np.where(valid, np.nan, values), colour, marker)
    axes.set_ylabel("sum of both ends, cm")


def _draw_offset(
    axes: Axes, frames: Sequence[FrameFigures], way: Array, index: int, scale: float
) -> None:
    valid = np.array([f.valid for f in frames])
    values = _scaled([f.offsets[index] if f.offsets else None for f in frames], scale)
    band = _SIGMAS * _scaled([f.sigmas[index] if f.sigmas else None for f in frames], scale)
    axes.fill_between(
        way, -band, band, color=_SKY, alpha=0.45, linewidth=0.0, label="±1.96 sigma, published"
    )
    # A frame whose neighbours have no band shows it as a stroke.
    axes.vlines(way, -band, band, color=_SKY, linewidth=1.0)
    axes.plot(
        way,
        np.where(valid, values, np.nan),
        color=_BLACK,
        marker="o",
        markersize=3.5,
        linewidth=1.0,
        label="error, valid frames",
    )
    _draw_carried(axes, way, np.where(valid, np.nan, values), _BLACK, "o")
    false = np.array([bool(f.false_reasons) for f in frames])
    if false.any():
        axes.plot(
            way[false],
            values[false],
            color=_VERMILION,
            marker="x",
            markersize=8.0,
            linestyle="none",
            label="false valid",
        )


def _draw_carried(axes: Axes, way: Array, values: Array, colour: str, marker: str) -> None:
    if np.isfinite(values).any():
        axes.plot(
            way,
            values,
            color=colour,
            marker=marker,
            markersize=4.0,
            markerfacecolor="white",
            linestyle="none",
            label="coasting" if colour == _BLACK else None,
        )


def _shade_invalid(axes: Axes, frames: Sequence[FrameFigures], way: Array) -> None:
    """Shade the frames that are not valid, half-way to their neighbours."""
    edges = _edges(way)
    label: str | None = "not valid"
    for f, low, high in zip(frames, edges[:-1], edges[1:], strict=True):
        if not f.valid:
            axes.axvspan(low, high, color="#EEEEEE", linewidth=0.0, label=label)
            label = None


def draw_coverage(evaluation: Evaluation, figure: Figure) -> None:
    """Draw the share of truths inside a region over the share that the region promises."""
    figure.set_size_inches(9.0, 5.2)
    valid = [f for f in evaluation.per_frame if f.valid]
    columns: Any = figure.subplots(1, 2, sharey=True)
    parts = (
        ("left and up", [f.nees for f in valid if f.nees is not None]),
        ("heading and pitch", [f.direction_nees for f in valid if f.direction_nees is not None]),
    )
    for axes, (name, nees) in zip(columns, parts, strict=True):
        draw_calibration(axes, name, np.array(nees))
    columns[0].set_ylabel("share of truths inside the region")
    figure.suptitle("Coverage of the published covariance, valid frames")


def draw_calibration(axes: Axes, name: str, nees: Array) -> None:
    """Draw the observed over the promised share of truths.

    Args:
        axes: where to draw.
        name: of the two numbers whose region it is.
        nees: their squared errors in units of their covariance, (N,).
    """
    levels = np.linspace(0.0, 0.999, 200)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=_BLACK, linewidth=0.8, linestyle="--", label="honest")
    axes.set_aspect("equal")
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("share that the region promises")
    if not len(nees):
        axes.set_title(name)
        _say_nothing(axes, "no frame with a covariance")
        return
    axes.fill_between(
        levels,
        binom.ppf(0.025, len(nees), levels) / len(nees),
        binom.ppf(0.975, len(nees), levels) / len(nees),
        color=_GREY,
        alpha=0.4,
        linewidth=0.0,
        label="chance, 95 %",
    )
    inside = [float(np.mean(nees <= chi2_quantile(level))) for level in levels]
    axes.plot(levels, inside, color=_BLUE, linewidth=1.8, label="observed")
    share = float(np.mean(nees <= chi2_quantile(0.95)))
    axes.plot([0.95], [share], color=_VERMILION, marker="o", linestyle="none", label="95 % region")
    axes.set_title(
        f"{name}: {100.0 * share:.0f} % of {len(nees)} in the 95 % region\n"
        f"mean squared error / covariance {nees.mean():.2f} (honest: 2)",
        fontsize=9,
    )
    axes.legend(loc="upper left")


def draw_states(evaluation: Evaluation, figure: Figure) -> None:
    """Draw over time what the tracker said and what there was to see."""
    figure.set_size_inches(9.0, 3.4)
    axes = figure.subplots()
    frames = evaluation.per_frame
    stamps = np.array([f.stamp_ns for f in frames])
    edges = _edges((stamps - stamps[0]) / _SECOND)
    lanes = list(_lanes(frames))
    for lane, (_, bars) in enumerate(lanes):
        for colour, chosen in bars:
            spans = [(edges[i], edges[i + 1] - edges[i]) for i, here in enumerate(chosen) if here]
            axes.broken_barh(
                spans, (lane - 0.4, 0.8), facecolors=colour, edgecolors="white", linewidth=0.4
            )
    axes.set_yticks(range(len(lanes)), [name for name, _ in lanes])
    axes.set_ylim(len(lanes) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel("time, s")
    counts = evaluation.counts
    axes.set_title(
        f"States: {counts.valid} of {counts.frames} frames valid, {counts.false_valid} false valid"
    )


def _lanes(
    frames: Sequence[FrameFigures],
) -> Iterator[tuple[str, list[tuple[str, list[bool]]]]]:
    """Yield lanes from top to bottom: name, and colours with the frames that have them."""
    for name in ("in_view", "detectable"):
        known = [getattr(f, name) for f in frames]
        title = {"in_view": "pipe in view", "detectable": "pipe detectable"}[name]
        if None not in known:
            yield title, [(_BLUE, [bool(k) for k in known])]
    for state, colour in _STATES.items():
        here = [f.state == state for f in frames]
        if state or any(here):
            yield state or "lost image", [(colour, here)]
    yield "recognised", [(_SKY, [f.valid and f.mode == "recognition" for f in frames])]
    yield "valid", [(_GREEN, [f.valid for f in frames])]
    yield "false valid", [(_VERMILION, [bool(f.false_reasons) for f in frames])]


def _edges(places: Array) -> Array:
    """Return the borders (N + 1,) half-way between N places in order."""
    if len(places) < 2:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    middles = (places[1:] + places[:-1]) / 2.0
    first, last = 2.0 * places[0] - middles[0], 2.0 * places[-1] - middles[-1]
    return np.concatenate(([first], middles, [last]))


def _scaled(values: Sequence[float | None], scale: float) -> Array:
    return scale * np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def _say_nothing(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
