"""An evaluation as tables for a terminal of 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from pipeline_tracker.evaluation.schema import (
    ContourFigures,
    Counts,
    Evaluation,
    Finding,
    Fit,
    MeanMax,
    SearchFigures,
    Setup,
    SignedError,
)

_TITLES = {
    "all": "all valid",
    "tracking": "tracking",
    "recognition": "recognition",
    "technique_1": "  technique 1",
    "technique_2": "  technique 2",
    "technique_3": "  technique 3",
    "technique_4": "  technique 4",
    "coasting": "coasting, invalid",
}
_ERRORS = {
    "heading_misalignment": ("heading", "deg", math.degrees(1.0)),
    "pitch_misalignment": ("pitch", "deg", math.degrees(1.0)),
    "min_distance": ("distance", "cm", 100.0),
    "lateral_offset": ("lateral offset", "cm", 100.0),
    "approach_speed": ("approach speed", "cm/s", 100.0),
}
_CONTOURS_NOTE = (
    "ends: mean at both ends of the lines; visible: mean beside visible parts; hidden: lines of "
    "contours that are not visible; side: lines on the wrong side; missed: visible contours "
    "without a line"
)
# A mounting that is further off is worth a line, m and rad.
_MOUNTING_OFF = 1e-4


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Print an evaluation."""
    lines = [
        _setup(evaluation.setup),
        *_fit(evaluation.fit),
        *_counts(evaluation.counts),
        *_finding(evaluation.finding),
    ]
    for line in lines:
        console.print(line, highlight=False)
    console.print(_divergence(evaluation))
    console.print(_errors(evaluation))
    contours = evaluation.groups["all"].contours
    if contours:
        console.print(_contours(contours))
        console.print(_CONTOURS_NOTE, highlight=False)


def _setup(setup: Setup) -> str:
    parts = [f"pipe {setup.pipe_diameter:g} m"]
    if setup.true_pipe_diameter not in (None, setup.pipe_diameter):
        parts[0] += f" (in truth {setup.true_pipe_diameter:g} m)"
    if setup.image_size is not None and setup.field_of_view is not None:
        width, height = setup.image_size
        parts.append(f"{width} x {height} px, {math.degrees(setup.field_of_view):.1f} deg wide")
    if setup.baseline is not None:
        parts.append(f"baseline {setup.baseline:g} m" if setup.baseline else "one camera")
    if setup.mounting_translation is not None and setup.mounting_rpy is not None:
        place = ", ".join(f"{v:g}" for v in setup.mounting_translation)
        turn = ", ".join(f"{math.degrees(v):.1f}" for v in setup.mounting_rpy)
        parts.append(f"camera at [{place}] m, rpy [{turn}] deg")
    lamps = (setup.scenario or {}).get("lamps")
    if isinstance(lamps, list):
        parts.append(_lamps(lamps))
    return "; ".join(parts)


def _lamps(lamps: list[Any]) -> str:
    places = [lamp.get("position") for lamp in lamps if isinstance(lamp, dict)]
    at = f" at {', '.join(map(str, places))} m" if places and all(places) else ""
    return f"{len(lamps)} lamp{'' if len(lamps) == 1 else 's'}{at}"


def _fit(fit: Fit) -> Iterator[str]:
    if not (fit.images_compared or fit.poses_compared or fit.steps_compared):
        yield (
            "not checked: nothing but the stamps says that this is the truth of this replay (no "
            "images and no poses to compare)"
        )
    off, angle = fit.mounting_offset or 0.0, fit.mounting_angle or 0.0
    if max(off, angle) > _MOUNTING_OFF:
        yield (
            f"the camera's mounting in the replay is {100.0 * off:.1f} cm and "
            f"{math.degrees(angle):.2f} degrees off the one in the bag"
        )


def _counts(counts: Counts) -> Iterator[str]:
    yield _share("frames", counts.valid, counts.frames)
    if counts.in_view is not None:
        yield _share("frames with the pipe in view", counts.in_view_valid, counts.in_view)
    if counts.detectable is None:
        yield "detectable frames not known: the bag does not tell which contours are hidden"
    else:
        yield _share("detectable frames", counts.detectable_valid, counts.detectable)
    reasons = ", ".join(f"{k} {n}" for k, n in counts.false_valid_reasons.items())
    yield f"{counts.false_valid} frames false valid{f' ({reasons})' if reasons else ''}"
    yield "states: " + ", ".join(f"{n} {state}" for state, n in counts.states.items())


def _share(what: str, valid: int | None, of: int) -> str:
    share = f" ({_percent(valid / of)})" if valid is not None and of else ""
    return f"{valid} of {of} {what} valid{share}"


def _finding(finding: Finding | None) -> Iterator[str]:
    if finding is None:
        return
    what = "detectable frames" if finding.basis == "detectable" else "frames in view"
    for title, figures in (
        ("to find the pipe", finding.to_find),
        ("to find it again", finding.to_find_again),
    ):
        if figures.searches:
            yield f"{what} {title}: {_searches(figures)}"


def _searches(figures: SearchFigures) -> str:
    vain = f"{figures.never_found} in vain over {figures.never_found_frames} frames"
    if figures.mean is None:
        return vain
    found = f"{figures.mean:.1f} on average, {figures.max} at most ({figures.found} found)"
    return f"{found}; {vain}" if figures.never_found else found


def _divergence(evaluation: Evaluation) -> Table:
    table = _table(
        "Divergence, sum of both ends, cm: average / max",
        ("", "frames", "horizontal", "vertical", "distance", "in 95 %"),
    )
    for name, group in evaluation.groups.items():
        d, share = group.divergence, group.coverage_95.share
        table.add_row(
            _TITLES[name],
            str(group.frames),
            *(_pair(part) for part in (d.horizontal, d.vertical, d.total)),
            "-" if share is None else _percent(share),
        )
    return table


def _errors(evaluation: Evaluation) -> Table:
    table = _table(
        "Errors, estimate less truth, all valid frames",
        ("", "unit", "frames", "mean", "rms", "extreme", "in 95 %"),
    )
    for column, error in evaluation.groups["all"].errors.items():
        title, unit, scale = _ERRORS[column]
        table.add_row(
            title,
            unit,
            str(error.frames),
            *_signed(error, scale),
            "-" if error.in_95 is None else _percent(error.in_95),
        )
    return table


def _contours(contours: dict[str, ContourFigures]) -> Table:
    table = _table(
        "Contour lines off the true contours, px, all valid frames",
        (
            "",
            "lines",
            "mean",
            "median",
            "95 %",
            "max",
            "ends",
            "visible",
            "hidden",
            "side",
            "missed",
        ),
        gap=1,
    )
    for name, line in contours.items():
        spread, visible = line.error_px, line.visible_error_px
        table.add_row(
            name.replace("_", " "),
            str(line.lines),
            *(_pixels(v) for v in (spread.mean, spread.median, spread.p95, spread.max)),
            _pixels(line.ends_px.mean),
            _pixels(None if visible is None else visible.mean),
            str(line.contours_not_visible),
            str(line.wrong_side),
            "-" if line.missed is None else str(line.missed),
        )
    return table


def _table(title: str, columns: tuple[str, ...], gap: int = 2) -> Table:
    table = Table(
        title=f"\n{title}",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, gap, 0, 0),
        header_style="none",
    )
    for name in columns:
        left = name in ("", "unit")
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    return table


def _pixels(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _pair(part: MeanMax) -> str:
    if part.mean is None or part.max is None:
        return "-"
    # Far off, the millimetres say nothing.
    digits = 2 if part.max < 1.0 else 0
    return f"{100.0 * part.mean:.{digits}f} / {100.0 * part.max:.{digits}f}"


def _signed(error: SignedError, scale: float) -> Iterator[str]:
    for value, sign in ((error.mean, "+"), (error.rms, ""), (error.extreme, "+")):
        yield "-" if value is None else f"{scale * value:{sign}.2f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
