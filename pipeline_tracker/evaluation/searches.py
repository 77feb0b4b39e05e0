"""Frames to find the pipe, and to find it again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from pipeline_tracker.evaluation.frames import FrameResult
from pipeline_tracker.evaluation.schema import Finding, SearchFigures


def finding(frames: Sequence[FrameResult]) -> Finding | None:
    """Count the frames that searches for the pipe took; ``Finding`` says what a search is.

    Args:
        frames: all frames of a replay in time order.

    Returns:
        The figures; None where it is not known of all frames whether the pipe can be found.
    """
    for basis in ("detectable", "in_view"):
        possible = [getattr(f.view, basis) for f in frames]
        if None not in possible:
            finds = [f.estimate.valid and not f.false_reasons for f in frames]
            return _finding(basis, possible, finds)
    return None


def _finding(basis: str, possible: Sequence[bool], finds: Sequence[bool]) -> Finding:
    marked = zip(possible, finds, strict=True)
    runs = [[f for _, f in run] for can, run in groupby(marked, lambda item: item[0]) if can]
    searches = [search for run in runs for search in _searches(run)]
    # The first search that finds is the last of those before the pipe was ever found.
    first = next((i + 1 for i, (_, found) in enumerate(searches) if found), len(searches))
    return Finding(
        basis=basis,
        runs=len(runs),
        to_find=_figures(searches[:first]),
        to_find_again=_figures(searches[first:]),
    )


def _searches(run: Sequence[bool]) -> Iterator[tuple[int, bool]]:
    """Yield length and success of each search in a run; a run begins with one."""
    length, searching = 0, True
    for finds in run:
        if finds and searching:
            yield length, True
        if finds:
            length, searching = 0, False
        else:
            length, searching = length + 1, True
    if searching:
        yield length, False


def _figures(searches: Sequence[tuple[int, bool]]) -> SearchFigures:
    lengths = [length for length, found in searches if found]
    never = [length for length, found in searches if not found]
    return SearchFigures(
        searches=len(searches),
        found=len(lengths),
        mean=sum(lengths) / len(lengths) if lengths else None,
        max=max(lengths, default=None),
        never_found=len(never),
        never_found_frames=sum(never),
        lengths=lengths,
    )
