"""The figures of a replay that a table shows, in a form that can be pooled over replays."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from pipeline_tracker.evaluation import Evaluation
from pipeline_tracker.evaluation.schema import Finding, MeanMax, SearchFigures, SignedError

_GROUPS = {"all": "", "tracking": "tracking_", "recognition": "recognition_"}


@dataclass(frozen=True)
class Stat:
    """A measure over frames.

    Attributes:
        n: frames (contour lines, searches) that have it.
        mean, rms: over them; None without frames (rms None too where it is not known).
        extreme: the value of greatest magnitude; None without frames.
    """

    n: int = 0
    mean: float | None = None
    rms: float | None = None
    extreme: float | None = None


@dataclass(frozen=True)
class Figures:
    """The figures of one replay, or of several together.

    Attributes:
        counts: frames by what became of them; None where the truth does not tell.
        reasons: why valid frames are false; a frame may have several.
        stats: measures over frames, SI units.
    """

    counts: dict[str, int | None] = field(default_factory=dict)
    reasons: dict[str, int] = field(default_factory=dict)
    stats: dict[str, Stat] = field(default_factory=dict)

    def share(self, part: str, of: str) -> float | None:
        """Return one count by another; None where one is not known or there is nothing."""
        a, b = self.counts.get(part), self.counts.get(of)
        return a / b if a is not None and b else None


def figures_of(evaluation: Evaluation) -> Figures:
    """Take the figures from an evaluation."""
    counts, stats = evaluation.counts, {}
    for group, prefix in _GROUPS.items():
        figures = evaluation.groups.get(group)
        if figures is None:
            continue
        divergence = figures.divergence
        stats[f"{prefix}horizontal"] = _of_mean_max(figures.frames, divergence.horizontal)
        stats[f"{prefix}vertical"] = _of_mean_max(figures.frames, divergence.vertical)
    valid = evaluation.groups["all"]
    for name, error in valid.errors.items():
        stats[name] = _of_signed(error)
    stats["covered"] = Stat(valid.coverage_95.frames, valid.coverage_95.share)
    if "all" in valid.contours:
        lines = valid.contours["all"]
        stats["contours"] = Stat(lines.measured, lines.error_px.mean, extreme=lines.error_px.max)
    return Figures(
        counts={
            name: getattr(counts, name)
            for name in ("frames", "valid", "detectable", "detectable_valid", "false_valid")
        }
        | _add_finding(evaluation.finding, stats),
        reasons=dict(counts.false_valid_reasons),
        stats=stats,
    )


def pooled(parts: Sequence[Figures]) -> Figures:
    """Return the figures of several replays as if their frames were those of one."""
    names = dict.fromkeys(name for part in parts for name in part.counts)
    counts: dict[str, int | None] = {}
    for name in names:
        values = [part.counts.get(name) for part in parts]
        # What one of them does not know is not known of all.
        known = [value for value in values if value is not None]
        counts[name] = sum(known) if len(known) == len(values) else None
    reasons: Counter[str] = Counter()
    for part in parts:
        reasons.update(part.reasons)
    measures = dict.fromkeys(name for part in parts for name in part.stats)
    stats = {name: _pooled([p.stats[name] for p in parts if name in p.stats]) for name in measures}
    return Figures(counts, dict(sorted(reasons.items())), stats)


def _pooled(stats: Sequence[Stat]) -> Stat:
    there = [stat for stat in stats if stat.n]
    n = sum(stat.n for stat in there)
    means = [(stat.n, stat.mean) for stat in there if stat.mean is not None]
    squares = [(stat.n, stat.rms**2) for stat in there if stat.rms is not None]
    square = _weighted(squares)
    return Stat(
        n,
        _weighted(means),
        None if square is None else math.sqrt(square),
        max((s.extreme for s in there if s.extreme is not None), key=abs, default=None),
    )


def _weighted(values: Sequence[tuple[int, float]]) -> float | None:
    frames = sum(n for n, _ in values)
    return math.fsum(n * value for n, value in values) / frames if frames else None


def _add_finding(finding: Finding | None, stats: dict[str, Stat]) -> dict[str, int | None]:
    """Add the lengths of searches; return how many searches failed."""
    failed: dict[str, int | None] = dict.fromkeys(("never_found", "never_found_again"))
    if finding is not None:
        stats["to_find"] = _of_searches(finding.to_find)
        stats["to_find_again"] = _of_searches(finding.to_find_again)
        failed["never_found"] = finding.to_find.never_found
        failed["never_found_again"] = finding.to_find_again.never_found
    return failed


def _of_searches(searches: SearchFigures) -> Stat:
    return Stat(searches.found, searches.mean, extreme=searches.max)


def _of_mean_max(frames: int, part: MeanMax) -> Stat:
    return Stat(frames if part.mean is not None else 0, part.mean, None, part.max)


def _of_signed(error: SignedError) -> Stat:
    return Stat(error.frames, error.mean, error.rms, error.extreme)
