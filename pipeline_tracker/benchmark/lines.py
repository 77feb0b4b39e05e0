"""The lines of a benchmark's table: one for each run, and one over the seeds of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Literal

from pipeline_tracker.benchmark.figures import Figures, figures_of, pooled
from pipeline_tracker.benchmark.geometry import Geometry, of_setup
from pipeline_tracker.benchmark.plan import Plan, RunTask
from pipeline_tracker.benchmark.results import read_run, read_sea
from pipeline_tracker.benchmark.work import Outcome


@dataclass(frozen=True)
class Line:
    """A line.

    Attributes:
        name, variant: of the run.
        seed: in words; empty for a bag.
        state: pooled: of those runs over the seeds that are done.
        reason: why it failed, in one line.
        geometry: under which it was measured.
        figures: empty unless done or pooled.
        seconds_simulate, seconds_replay: how long it took; None unknown.
        median_ms: median time of a frame, of several runs the median of theirs.
    """

    name: str
    seed: str
    variant: str
    state: Literal["done", "failed", "not done", "pooled"]
    geometry: Geometry
    reason: str = ""
    figures: Figures = field(default_factory=Figures)
    seconds_simulate: float | None = None
    seconds_replay: float | None = None
    median_ms: float | None = None


def make_lines(plan: Plan, root: Path, outcomes: Mapping[str, Outcome]) -> list[Line]:
    """Return the lines of all runs, those that failed included, in the plan's order.

    Runs of one scenario and variant with several seeds are followed by a pooled line.

    Args:
        plan: the plan.
        root: the benchmark's directory.
        outcomes: what became of the runs that this command tried, by their directory.
    """
    families: dict[tuple[str, str], list[RunTask]] = {}
    for run in plan.runs:
        families.setdefault((run.name, run.variant), []).append(run)
    lines = []
    for runs in families.values():
        family = [_line(run, root, outcomes.get(run.directory)) for run in runs]
        lines += family
        if len(family) > 1:
            lines += _pooled_line(family)
    return lines


def _line(run: RunTask, root: Path, outcome: Outcome | None) -> Line:
    seed = "" if run.seed is None else str(run.seed)
    failed = outcome is not None and outcome.reason
    result = None if failed else read_run(root / run.directory)
    if result is None:
        reason = outcome.reason if outcome is not None else ""
        state: Literal["failed", "not done"] = "failed" if outcome is not None else "not done"
        reason = reason or ("its result is gone" if outcome is not None else "")
        return Line(run.name, seed, run.variant, state, run.geometry or Geometry(), reason)
    sea = None if run.sea is None else read_sea(root / run.sea.directory)
    return Line(
        run.name,
        seed,
        run.variant,
        "done",
        run.geometry or of_setup(result.evaluation.setup),
        figures=figures_of(result.evaluation),
        seconds_simulate=None if sea is None else sea.seconds_simulate,
        seconds_replay=result.times.seconds_replay,
        median_ms=result.times.median_ms,
    )


def _pooled_line(family: Sequence[Line]) -> list[Line]:
    done = [line for line in family if line.state == "done"]
    if not done:
        return []
    first, seeds = family[0], f"{len(family)} seeds"
    if len(done) < len(family):
        seeds = f"{len(done)} of {seeds}"
    medians = [line.median_ms for line in done if line.median_ms is not None]
    return [
        Line(
            first.name,
            seeds,
            first.variant,
            "pooled",
            first.geometry,
            figures=pooled([line.figures for line in done]),
            seconds_simulate=_total([line.seconds_simulate for line in done]),
            seconds_replay=_total([line.seconds_replay for line in done]),
            median_ms=median(medians) if medians else None,
        )
    ]


def _total(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None
