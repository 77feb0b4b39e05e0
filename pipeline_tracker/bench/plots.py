"""Pictures of a bench: growth, and a flame graph of a pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline_tracker.bench.sampling import Profile, Stack
from pipeline_tracker.bench.schema import GrowthLine
from pipeline_tracker.errors import BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GROWTH, FLAME = "growth.png", "flame.png"
# Okabe and Ito.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_MARKERS = ("o", "s", "^", "D")
_FLAMES = ("#E69F00", "#F0B94D", "#EEA86B", "#F5D08A", "#E8935A")
_LEAST_WIDTH = 0.002
# Inches of a character at the size of the labels.
_CHARACTER = 0.068


def write_plots(growth: Sequence[GrowthLine], profile: Profile, directory: Path) -> list[Path]:
    """Write ``growth.png`` and ``flame.png`` into a directory, which is made.

    Raises:
        BenchError: one cannot be written.
    """
    draws: dict[str, Callable[[Figure], None]] = {
        GROWTH: lambda figure: draw_growth(growth, figure),
        FLAME: lambda figure: draw_flame(profile, figure),
    }
    return [_write(draw, directory / name) for name, draw in draws.items()]


def _write(draw: Callable[[Figure], None], path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    draw(figure)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Software": None})
    except OSError as error:
        raise BenchError(
            f"--plots: {path} cannot be written ({error.strerror}); name another directory"
        ) from None
    return path


def draw_growth(growth: Sequence[GrowthLine], figure: Figure) -> None:
    """Draw time against pixels and against segments, both scales logarithmic."""
    figure.set_size_inches(9.0, 4.2)
    axes = figure.subplots(1, 2)
    for place, unit in zip(axes, ("pixels", "segments"), strict=True):
        lines = [line for line in growth if line.unit == unit]
        for k, line in enumerate(lines):
            place.loglog(
                line.x,
                line.ms,
                color=_COLOURS[k % len(_COLOURS)],
                marker=_MARKERS[k % len(_MARKERS)],
                markersize=5,
                label=f"{line.label}: exponent {line.exponent:.2f}",
            )
        if lines:
            low, high = lines[0].x[0], lines[0].x[-1]
            start = min(line.ms[0] for line in lines) * 0.6
            place.loglog(
                [low, high], [start, start * high / low], color="#999999", ls="--", label="linear"
            )
        place.set_xlabel("pixels of an image" if unit == "pixels" else "segments of an image")
        place.set_ylabel("median, ms")
        place.grid(color="#E5E5E5")
        place.set_axisbelow(True)
        place.spines[["top", "right"]].set_visible(False)
        place.legend(frameon=False, fontsize=8)


def draw_flame(profile: Profile, figure: Figure) -> None:
    """Draw a flame graph: width is the share of time, above a function are those that it calls."""
    inclusive: Counter[Stack] = Counter()
    for stack, times in profile.stacks.items():
        for depth in range(1, len(stack) + 1):
            inclusive[stack[:depth]] += times
    total = max(profile.samples, 1)
    depth = max((len(path) for path in inclusive), default=1)
    wide, high = 15.0, 0.3 * depth + 0.9
    figure.set_size_inches(wide, high)
    axes = figure.subplots()
    _draw_below((), 0.0, inclusive, total, axes, wide)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, float(depth))
    axes.set_yticks([])
    axes.set_xlabel(
        f"share of a tracked pair; {profile.samples} samples over {profile.pairs} pairs; "
        "the uppermost box of a pile is the line of code at work"
    )
    axes.spines[["top", "right", "left"]].set_visible(False)


def _draw_below(
    parent: Stack, left: float, inclusive: Counter[Stack], total: int, axes: Axes, wide: float
) -> None:
    children = [path for path in inclusive if len(path) == len(parent) + 1 and path[:-1] == parent]
    for path in sorted(children, key=lambda p: -inclusive[p]):
        width = inclusive[path] / total
        if width < _LEAST_WIDTH:
            break
        bottom = len(parent)
        colour = _FLAMES[sum(map(ord, path[-1])) % len(_FLAMES)]
        axes.barh(
            bottom,
            width,
            height=0.94,
            left=left,
            align="edge",
            color=colour,
            edgecolor="white",
            linewidth=0.6,
        )
        room = int(width * wide / _CHARACTER) - 1
        text = path[-1] if len(path[-1]) <= room else f"{path[-1][: room - 1]}…"
        if room >= 4:
            axes.text(left + 0.001, bottom + 0.47, text, fontsize=7.5, va="center", clip_on=True)
        _draw_below(path, left, inclusive, total, axes, wide)
        left += width
