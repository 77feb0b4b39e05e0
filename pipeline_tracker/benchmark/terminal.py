"""The table on a terminal: in parts that fit its width."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from pipeline_tracker.benchmark.columns import all_columns
from pipeline_tracker.benchmark.lines import Line

_NOTE = "note"
# Title of a part, and of its columns, with the keys whose values stand in it.
_Columns = dict[str, tuple[str, ...]]
_FOUND: _Columns = {
    "frames": ("frames",),
    "valid %": ("valid_percent",),
    "detectable": ("detectable",),
    "of these valid %": ("detectable_valid_percent",),
    "false valid": ("false_valid",),
    "frames to find": ("frames_to_find",),
    "to find again": ("frames_to_find_again",),
    "": (_NOTE,),
}
_DIVERGENCE: _Columns = {
    "all h": ("horizontal_mean_cm", "horizontal_max_cm"),
    "all v": ("vertical_mean_cm", "vertical_max_cm"),
    "tracking n": ("tracking_measured",),
    "tracking h": ("tracking_horizontal_mean_cm", "tracking_horizontal_max_cm"),
    "tracking v": ("tracking_vertical_mean_cm", "tracking_vertical_max_cm"),
    "recogn. n": ("recognition_measured",),
    "recogn. h": ("recognition_horizontal_mean_cm", "recognition_horizontal_max_cm"),
    "recogn. v": ("recognition_vertical_mean_cm", "recognition_vertical_max_cm"),
}
_ERRORS: _Columns = {
    "heading, deg": ("heading_mean_deg", "heading_rms_deg"),
    "pitch, deg": ("pitch_mean_deg", "pitch_rms_deg"),
    "distance, cm": ("distance_mean_cm", "distance_rms_cm"),
    "lateral, cm": ("lateral_mean_cm", "lateral_rms_cm"),
    "approach, cm/s": ("speed_mean_cm_per_s", "speed_rms_cm_per_s"),
    "in 95 %": ("coverage_95_percent",),
    "contours, px": ("contours_mean_px", "contours_max_px"),
}
_TIME: _Columns = {
    "simulate, s": ("simulate_s",),
    "replay, s": ("replay_s",),
    "median, ms": ("median_ms",),
}
_GEOMETRY: _Columns = {
    "camera, px": ("camera",),
    "view, deg": ("field_of_view_deg",),
    "baseline, m": ("baseline_m",),
    "distance, m": ("distance_m",),
    "diameter, m": ("diameter_m",),
    "mounting, m; deg": ("mounting",),
    "lamps, m": ("lamps",),
}
_WORDS = (_NOTE, "mounting", "lamps")
# Around a table, between columns, and the room that a column of words asks for at least.
_FRAME, _GAP, _LONG = 4, 2, 30
# Where nobody looks at a terminal, as wide as the parts need.
_WIDE = 160


def print_tables(lines: Sequence[Line], console: Console) -> None:
    """Print the table in parts; runs that failed stand in the first with their reason."""
    if not console.is_terminal:
        console.width = max(console.width, _WIDE)
    measured = [line for line in lines if line.state in ("done", "pooled")]
    # Neither seed nor settings change the geometry.
    one_of_each = list({line.name: line for line in reversed(lines)}.values())[::-1]
    parts = [("What was found", _FOUND, lines)]
    if measured:
        parts += [
            ("Divergence of the segment, sum of both ends, cm: mean/max", _DIVERGENCE, measured),
            ("Errors, estimate less truth: mean/rms (contours: mean/max)", _ERRORS, measured),
            ("Time", _TIME, measured),
        ]
    for title, columns, chosen in parts:
        _print(title, columns, chosen, [_run(line) for line in chosen], console)
    names = [line.name for line in one_of_each]
    _print("Geometry of all figures above", _GEOMETRY, one_of_each, names, console)


def _print(
    title: str, columns: _Columns, lines: Sequence[Line], names: Sequence[str], console: Console
) -> None:
    """Print a part; what is too wide for the console stands in a further table below."""
    room = console.width - max(map(len, names)) - _FRAME
    part: _Columns = {}
    used = 0
    for name, keys in columns.items():
        wide = _width(name, keys, lines)
        if part and used + wide > room:
            console.print(_table(title, part, lines, names))
            part, used, title = {}, 0, ""
        part[name] = keys
        used += wide
    console.print(_table(title, part, lines, names))


def _width(name: str, keys: tuple[str, ...], lines: Sequence[Line]) -> int:
    words = max(map(len, name.split()), default=0)
    cells = max(len(_cell(line, keys)) for line in lines)
    return _GAP + max(words, min(cells, _LONG) if keys[0] in _WORDS else cells)


def _table(title: str, columns: _Columns, lines: Sequence[Line], names: Sequence[str]) -> Table:
    table = Table(
        title=title or None, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left"
    )
    table.add_column("", no_wrap=True)
    for name, keys in columns.items():
        words = keys[0] in _WORDS
        table.add_column(
            "\n".join(name.split()), justify="left" if words else "right", no_wrap=not words
        )
    for name, line in zip(names, lines, strict=True):
        cells = [Text(_cell(line, keys)) for keys in columns.values()]
        table.add_row(Text(name), *cells, style="bold" if line.state == "pooled" else None)
    return table


def _run(line: Line) -> str:
    return " ".join(filter(None, (line.name, line.seed, line.variant)))


def _cell(line: Line, keys: tuple[str, ...]) -> str:
    if keys == (_NOTE,):
        return _note(line)
    shown = {column.key: column.shown(line) for column in all_columns() if column.key in keys}
    cells = [shown[key] for key in keys]
    return "-" if set(cells) == {"-"} else "/".join(cells)


def _note(line: Line) -> str:
    if line.state in ("failed", "not done"):
        return f"{line.state}: {line.reason}" if line.reason else line.state
    return ", ".join(f"{name} {n}" for name, n in line.figures.reasons.items())
