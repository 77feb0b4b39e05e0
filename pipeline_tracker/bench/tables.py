"""The figures for people, 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline_tracker.bench.schema import (
    BenchReport,
    GrowthLine,
    Live,
    Machine,
    Memory,
    Shares,
    SizeReport,
)
from pipeline_tracker.bench.stock import NO_SKELETON

WIDTH = 80
_NAME = 37
_BUSY = 0.5


def print_report(report: BenchReport, console: Console) -> None:
    """Print all that was measured."""
    for line in _head(report.machine, report.bag, report.stock_skeleton):
        console.print(Text(line))
    for size in report.sizes:
        console.print(_size_table(size))
        console.print(Text(_below_size(size)))
    console.print(_shares_table(report.shares))
    if report.growth is not None:
        console.print(_growth_table(report.growth))
    if report.live is not None:
        console.print(_live_table(report.live))
        console.print(Text(_below_live(report.live)))
    if report.memory is not None:
        console.print(Text(_memory(report.memory)))


def _head(machine: Machine, bag: str, skeleton: str) -> Iterator[str]:
    kept = "not kept to one core" if machine.core is None else "kept to one core"
    yield f"{machine.processor}, {machine.cores} cores; one thread, {kept}"
    load = machine.load_before
    if load is not None:
        words = ", ".join(f"{value:.2f}" for value in load)
        busy = f"; above {_BUSY}: other programs disturb" if load[0] > _BUSY else ""
        yield f"load average before: {words}{busy}"
    yield f"images: {bag}, resized; times of a pair of images, ms"
    if skeleton == NO_SKELETON:
        yield (
            "stock chain: without skeletonization, none is installed; pip install '.[bench]' in "
            "the clone"
        )
    else:
        yield f"stock: CLAHE, Canny, {skeleton}, findContours, approxPolyDP"
        if not skeleton.startswith("cv2"):
            yield "(for OpenCV's own thinning, and EDLines, install its contrib build instead)"


def _table(title: str, first: str, *columns: str, wide: int = _NAME) -> Table:
    table = Table(
        title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left", width=WIDTH
    )
    table.add_column(first, min_width=wide, no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right")
    return table


def _size_table(size: SizeReport) -> Table:
    table = _table(
        f"{size.width} x {size.height}, {size.segments} segments an image",
        "",
        "min",
        "median",
        "p95",
        "x faster\nthan stock",
        "of",
    )
    for key, timing in size.timings.items():
        counted = f"{timing.counted}/{timing.rounds}"
        figures = [_ms(v) for v in (timing.min_ms, timing.median_ms, timing.p95_ms)]
        table.add_row(
            Text(timing.label),
            *figures,
            _ratio(timing.ratio),
            counted,
            style="bold" if key in {"pair", "stock"} else None,
        )
    return table


def _below_size(size: SizeReport) -> str:
    steps = ", ".join(f"{name} {_ms(value)}" for name, value in size.stock_steps_ms.items())
    return (
        f"matches {_ms(size.matching_ms)}; stock chain: {steps}\n"
        f"modified Hough x {_ratio(size.hough_ratio)} faster than pixels; "
        f"pair x {_ratio(size.ratio)} faster than stock"
    )


def _shares_table(shares: Shares) -> Table:
    title = (
        f"A tracked pair at {shares.width} x {shares.height}: {shares.samples} samples, "
        f"{shares.pairs} pairs"
    )
    table = _table(title, "", "share, %")
    for step in shares.steps:
        table.add_row(
            Text("  " * (len(step.path) - 1) + step.path[-1]), f"{100.0 * step.share:.1f}"
        )
    return table


def _growth_table(growth: Sequence[GrowthLine]) -> Table:
    names = ("over", "sizes", "ms", "exponent")
    table = _table("Growth (exponent 1: linear)", "", *names, wide=24)
    for line in growth:
        times = f"{_ms(line.ms[0])} - {_ms(line.ms[-1])}"
        sizes = f"{_count(line.x[0])} - {_count(line.x[-1])}"
        table.add_row(Text(line.label), line.unit, sizes, times, f"{line.exponent:.2f}")
    return table


def _live_table(live: Live) -> Table:
    table = Table(
        title=f"Live, {live.width} x {live.height}: image stamp to relative state over DDS",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        title_justify="left",
        width=WIDTH,
    )
    names = ("Hz", "nodes in", "ready\ns", "first\nms", "p50\nms", "p99\nms", "max\nms")
    for name in (*names, "dropped", "CPU\n%", "MB"):
        table.add_column(name, justify="right")
    for row in live.rows:
        place = "1 process" if row.processes == 1 else f"{row.processes} proc."
        table.add_row(
            f"{row.hertz:g}",
            "1 core" if row.one_core else place,
            f"{row.ready_s:.1f}",
            *(_ms(value) for value in (row.first_ms, row.p50_ms, row.p99_ms, row.max_ms)),
            f"{row.dropped}/{row.published}",
            f"{row.cpu_percent:.0f}",
            f"{row.memory_mb:.0f}",
        )
    return table


def _below_live(live: Live) -> str:
    loads = [row.load for row in live.rows if row.load is not None]
    words = f"; load average meanwhile {min(loads):.1f} to {max(loads):.1f}" if loads else ""
    return f"ready with nothing compiled before: {live.ready_cold_s:.1f} s (one process){words}"


def _memory(memory: Memory) -> str:
    return (
        f"memory over {memory.frames} pairs ({memory.tracked} tracked): "
        f"{memory.start_mb:.0f} MB after a tenth, {memory.end_mb:.0f} MB at the end, "
        f"{memory.most_mb:.0f} MB at most, {memory.growth_mb_per_1000:+.2f} MB a thousand"
    )


def _count(value: float) -> str:
    if value < 1e4:
        return f"{value:.0f}"
    return f"{value / 1e6:.1f} M" if value >= 1e6 else f"{value / 1e3:.0f} k"


def _ms(value: float | None) -> str:
    if value is None:
        return "-"
    if value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.1f}" if value >= 1.0 else f"{value:.2f}"


def _ratio(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2g}" if value < 1.0 else f"{value:.1f}"
