"""The command: read the images, measure, print, write."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.status import Status

from pipeline_tracker import __version__
from pipeline_tracker.bench.growth import measure_growth
from pipeline_tracker.bench.live import check_live, measure_live
from pipeline_tracker.bench.machine import describe_machine, load_average
from pipeline_tracker.bench.measure import measure_size, profile_pair
from pipeline_tracker.bench.memory import measure_memory, process_tools
from pipeline_tracker.bench.options import REFERENCE, BenchOptions
from pipeline_tracker.bench.plots import write_plots
from pipeline_tracker.bench.recording import Recording, read_recording
from pipeline_tracker.bench.schema import BenchReport
from pipeline_tracker.bench.stock import StockMethods
from pipeline_tracker.bench.tables import WIDTH, print_report
from pipeline_tracker.bench.timing import one_thread
from pipeline_tracker.errors import BenchError
from pipeline_tracker.pipeline import warm_up


def bench_command(
    options: BenchOptions,
    json_file: Path | None = None,
    *,
    console: Console | None = None,
    progress: Console | None = None,
) -> BenchReport:
    """Measure, print tables, and write the JSON.

    Args:
        options: what to measure.
        json_file: where to write the figures; None: nowhere.
        console: where tables are printed; standard output by default.
        progress: where progress is told; standard error by default.

    Raises:
        PipelineTrackerError: the bag, a setting or a file cannot be used, or something that an
            option needs is not installed.
    """
    # What is missing is told before the minutes that measuring takes.
    _check(options, json_file)
    recording = read_recording(options.images, options.settings)
    if options.live:
        check_live(recording)
    with (progress or Console(stderr=True)).status("compiling") as status:
        report = _measure(options, recording, status)
    if json_file is not None:
        _write(json_file, f"{report.model_dump_json(indent=2)}\n")
    print_report(report, console or Console(width=WIDTH, highlight=False))
    return report


def _check(options: BenchOptions, json_file: Path | None) -> None:
    if options.frames is not None:
        process_tools("--frames")
    if options.plots is not None and options.plots.exists() and not options.plots.is_dir():
        raise BenchError(f"--plots {options.plots}: is a file, expected a directory")
    if json_file is not None and (json_file.is_dir() or not json_file.parent.is_dir()):
        raise BenchError(
            f"--json {json_file}: cannot be written; expected a file in a directory that exists"
        )


def _measure(options: BenchOptions, recording: Recording, status: Status) -> BenchReport:
    load = load_average()
    stock = StockMethods()
    main = recording.resized(options.main_size)
    with one_thread():
        warm_up()
        sizes = []
        for size in options.sizes:
            status.update(f"measuring at {size[0]} x {size[1]}")
            sizes.append(measure_size(recording.resized(size), stock, options.rounds(size)))
        status.update("sampling a tracked pair")
        profile = profile_pair(main)
        growth = None
        if options.plots is not None:
            status.update("measuring growth")
            growth = measure_growth(recording, options.main_size)
            write_plots(growth, profile, options.plots)
        memory = None
        if options.frames is not None:
            status.update(f"memory over {options.frames} pairs")
            memory = measure_memory(main, options.frames)
    machine = describe_machine(load)
    live = measure_live(main, status.update) if options.live else None
    at_top = next((s for s in sizes if (s.width, s.height) == REFERENCE), None)
    return BenchReport(
        pair_ms=at_top.pair_ms if at_top else None,
        stock_pair_ms=at_top.stock_pair_ms if at_top else None,
        ratio=at_top.ratio if at_top else None,
        stock_skeleton=stock.skeleton.name,
        pipeline_tracker=__version__,
        bag=recording.name,
        machine=machine,
        sizes=sizes,
        shares=profile.shares(options.main_size),
        growth=growth,
        live=live,
        memory=memory,
    )


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BenchError(f"--json {path}: cannot be written ({error.strerror or error})") from None
