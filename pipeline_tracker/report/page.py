"""The page of a report as HTML; what it draws and how it looks is in page.js and page.css."""

from __future__ import annotations

import base64
import gzip
import platform
import re
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import cache
from importlib import resources
from pathlib import Path
from statistics import median
from xml.etree import ElementTree as ET

from plotly import __version__ as plotly_version
from plotly.offline import get_plotlyjs

from pipeline_tracker import __version__
from pipeline_tracker.evaluation.schema import Evaluation
from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.report import words
from pipeline_tracker.report.data import page_data
from pipeline_tracker.report.errors_table import add_errors
from pipeline_tracker.report.html import add
from pipeline_tracker.report.record import Record, seconds_of
from pipeline_tracker.report.stretches import Course, Stretch

# The page may load nothing at all; a browser holds it to that.
_POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
)
# Longer tables would make the page slow; estimates.csv has it all.
_MOST_STRETCHES = 2000
# Clocks that were never set begin at 0.
_SET_CLOCK = 946_684_800


def page(record: Record, evaluation: Evaluation | None) -> str:
    """Return the page.

    Args:
        record: the replay.
        evaluation: its errors; None without a truth.
    """
    title = f"Pipeline report: {_name(record)}"
    html = ET.Element("html", lang="en")
    head, body = ET.SubElement(html, "head"), ET.SubElement(html, "body")
    ET.SubElement(head, "meta", charset="utf-8")
    ET.SubElement(head, "meta", {"http-equiv": "Content-Security-Policy", "content": _POLICY})
    ET.SubElement(head, "meta", name="viewport", content="width=device-width, initial-scale=1")
    ET.SubElement(head, "meta", name="color-scheme", content="light dark")
    add(head, "title", title)
    add(head, "style", _file("page.css"))
    main = ET.SubElement(body, "main")
    _head(main, record)
    _summary(main, record, evaluation)
    if record.rows:
        _frames(main, record)
        _ways(main, record)
        _stretches(main, record)
    if evaluation is not None:
        add_errors(main, evaluation)
    _settings(main, record)
    data = {"type": "application/json", "id": "data"}
    ET.SubElement(body, "script", data).text = page_data(record, evaluation)
    library = {"type": "text/plain", "id": "plotly"}
    ET.SubElement(body, "script", library).text = _plotly()
    ET.SubElement(body, "script").text = _file("page.js")
    return "<!DOCTYPE html>\n" + ET.tostring(html, encoding="unicode", method="html") + "\n"


@cache
def _plotly() -> str:
    """Return the plotting library, packed: 2 MB instead of 5."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()


@cache
def _file(name: str) -> str:
    return (resources.files("pipeline_tracker") / "report" / name).read_text(encoding="utf-8")


def _name(record: Record) -> str:
    return record.facts.bag if record.facts else record.directory.resolve().name


def _head(main: ET.Element, record: Record) -> None:
    head = add(main, "header")
    add(head, "h1", _name(record))
    parts = ["Pipeline report"]
    if record.rows:
        first = int(record.rows[0]["stamp_ns"]) / SECOND_NS
        if first > _SET_CLOCK:
            begun = datetime.fromtimestamp(first, timezone.utc)
            parts.append(f"recorded {begun:%Y-%m-%d %H:%M:%S} UTC")
    parts.append(f"pipe of {record.settings.pipe.diameter:g} m")
    add(head, "p", " · ".join(parts), class_="sub")


def _summary(main: ET.Element, record: Record, evaluation: Evaluation | None) -> None:
    section = add(main, "section", class_="summary", aria_label="Summary")
    first, *rest = words.summary(record)
    add(section, "p", _tied(first), class_="lead")
    for sentence in rest:
        add(section, "p", _tied(sentence))
    for note in words.notes(record):
        add(section, "p", note, class_="note")
    tiles = add(section, "dl", class_="tiles")
    for name, value, unit in _tiles(record, evaluation):
        tile = add(tiles, "div")
        add(tile, "dt", name)
        add(add(tile, "dd", value), "span", f" {unit}" if unit else "")


def _tied(sentence: str) -> str:
    """Return a sentence whose numbers stay with their units where a line ends."""
    return re.sub(r"(?<=\d) (?=(?:s|m|cm|h|min|frames?)\b|%)", "\N{NO-BREAK SPACE}", sentence)


def _tiles(record: Record, evaluation: Evaluation | None) -> list[tuple[str, str, str]]:
    """Return the key figures: name, value, unit."""
    rows = record.rows
    valid = sum(row["valid"] == "1" for row in rows)
    share = 100.0 * valid / len(rows) if rows else 0.0
    tiles = [("frames followed", f"{valid} / {len(rows)}", f"{int(share)} %" if rows else "")]
    length = words.followed_length(record.stretches)
    if length is not None:
        tiles.append(("length followed", f"{length:.1f}", "m"))
    qualities = [state.quality for state in record.states.values() if state.valid]
    if qualities:
        tiles.append(("median quality", f"{median(qualities):.2f}", ""))
    distances = [state.min_distance for state in record.states.values() if state.valid]
    if distances:
        tiles.append(("median distance", f"{median(distances):.2f}", "m"))
    if evaluation is not None:
        mean = evaluation.groups["all"].divergence.total.mean
        if mean is not None:
            tiles.append(("mean error, both ends", f"{100.0 * mean:.2f}", "cm"))
        tiles.append(("valid but wrong", str(evaluation.counts.false_valid), "frames"))
    return tiles


def _frames(main: ET.Element, record: Record) -> None:
    """Add time lines beside the picture of the chosen frame, and the film strip."""
    section = add(main, "section", aria_labelledby="frames")
    add(section, "h2", "Along the time line", id="frames")
    add(
        section,
        "p",
        "A click chooses a frame, the arrow keys step from picture to picture, with Shift from "
        "frame to frame. Shaded: not valid (lighter, with a dotted edge: carried on by the "
        "pose alone); bands and ±: 95 %. Drag to zoom (on a phone: the buttons above), "
        "double-click to go back.",
        class_="hint",
    )
    both = add(section, "div", class_="both")
    add(both, "div", id="timelines", class_="plot", role="img",
        aria_label="Time lines of state, quality, heading, pitch, distance and speed")  # fmt: skip
    player = add(both, "div", class_="player")
    figure = add(player, "figure")
    ET.SubElement(figure, "img", id="picture", alt="", width="640", height="427")
    add(figure, "figcaption", id="caption", aria_live="polite")
    controls = add(player, "div", class_="controls")
    add(controls, "button", "◀", id="back", type="button", aria_label="Picture before")
    ET.SubElement(
        controls,
        "input",
        {
            "type": "range",
            "id": "slider",
            "min": "0",
            "max": str(len(record.rows) - 1),
            "value": "0",
            "aria-label": "Frame",
        },
    )
    add(controls, "button", "▶", id="on", type="button", aria_label="Picture after")
    add(player, "dl", id="values", class_="values")
    key = add(player, "p", class_="key")
    for name, what in (
        ("left", "contour to port"), ("right", "contour to starboard"), ("axis", "axis, ahead"),
        ("missing", "dashed: expected there, not found"),
    ):  # fmt: skip
        add(key, "span", what, class_=name)
    _strip(section, record)


def _strip(section: ET.Element, record: Record) -> None:
    if not record.pictures:
        add(section, "p", "There are no pictures in frames/ of this replay.", class_="hint")
        return
    strip = add(section, "div", id="strip", class_="strip", aria_label="Pictures", role="group")
    for k, row in enumerate(record.rows):
        path = record.pictures.get(int(row["stamp_ns"]))
        if path is None:
            continue
        valid = row["valid"] == "1"
        time = f"{seconds_of(record, int(row['stamp_ns'])):.1f} s"
        said = row["state"] or "not processed"
        state = "valid" if valid else f"not valid, {said}"
        button = add(strip, "button", type="button", data_row=str(k), tabindex="-1",
                     class_="" if valid else "lost", aria_label=f"{time}, {state}")  # fmt: skip
        picture = base64.b64encode(path.read_bytes()).decode()
        ET.SubElement(
            button,
            "img",
            src=f"data:image/jpeg;base64,{picture}",
            alt="",
            loading="lazy",
            decoding="async",
        )
        add(button, "span", time if valid else f"{time} ✕")


def _ways(main: ET.Element, record: Record) -> None:
    """Add plan view and long profile."""
    section = add(main, "section", aria_labelledby="ways")
    add(section, "h2", "Where it runs", id="ways")
    if not record.placed:
        reason = "the vehicle's poses are not known" if not record.poses else "it was never found"
        add(section, "p", f"Plan and profile cannot be drawn: {reason}.", class_="hint")
        if not record.poses:
            return
    add(
        section,
        "p",
        "In the frame odom, as the visual navigation gives it: its drift is in both lines. "
        "The band about the axis is its 95 % region relative to the vehicle (zoom in to see it).",
        class_="hint",
    )
    add(section, "h3", "Plan")
    add(section, "div", id="plan", class_="plot", role="img",
        aria_label="Plan view of the pipe and of the vehicle's path")  # fmt: skip
    if any(place.chainage is not None for place in record.placed.values()):
        add(section, "h3", "Long profile")
        add(section, "div", id="profile", class_="plot", role="img",
            aria_label="Height of pipe, bed and vehicle over chainage")  # fmt: skip


def _stretches(main: ET.Element, record: Record) -> None:
    section = add(main, "section", aria_labelledby="stretches")
    add(section, "h2", "Stretches", id="stretches")
    add(
        section,
        "p",
        "How the pipe lies is judged by the bed on both sides of it, where the pictures show it: "
        "a hint, no survey. Positive clearance: the bed beside the pipe lies so far below it; "
        "negative: so much of the pipe is below the bed beside it. Axis above bed: to port / to "
        "starboard.",
        class_="hint",
    )
    shown = record.stretches[:_MOST_STRETCHES]
    box = add(section, "div", class_="scroll", tabindex="0", role="region", aria_label="Stretches")
    table = add(box, "table")
    head = add(add(table, "thead"), "tr")
    for name in ("chainage from", "to", "length", "state", "lies", "clearance", "axis above bed",
                 "time", "frames", "why"):  # fmt: skip
        add(head, "th", name, scope="col")
    body = add(table, "tbody")
    for stretch in shown:
        _stretch(body, record, stretch)
    if len(record.stretches) > len(shown):
        rest = len(record.stretches) - len(shown)
        add(section, "p", f"and {rest} further stretches: see estimates.csv.", class_="hint")


def _stretch(body: ET.Element, record: Record, stretch: Stretch) -> None:
    followed = stretch.course is Course.FOLLOWED
    row = add(body, "tr", class_="" if followed else "lost")
    for value in (stretch.chainage_from, stretch.chainage_to, stretch.length):
        add(row, "td", _metres(value, 1), class_="number")
    add(row, "td", stretch.course.value)
    add(row, "td", stretch.lie.value if followed else "")
    add(row, "td", _metres(stretch.clearance, 2, sign=True), class_="number")
    sides = (stretch.bed_left, stretch.bed_right)
    above = " / ".join("?" if side is None else f"{round(side, 2) + 0.0:.2f}" for side in sides)
    above = "" if sides == (None, None) else f"{above} m"
    add(row, "td", above, class_="number")
    start, end = (seconds_of(record, ns) for ns in (stretch.start_ns, stretch.end_ns))
    cell = add(row, "td", class_="number")
    times = f"{start:.1f} s" if start == end else f"{start:.1f} to {end:.1f} s"
    add(cell, "button", times, type="button", class_="link", data_row=str(stretch.first))
    add(row, "td", str(stretch.frames), class_="number")
    add(row, "td", "" if followed else words.why(stretch), class_="why")


def _metres(value: float | None, decimals: int, *, sign: bool = False) -> str:
    if value is None:
        return ""
    # No negative zero.
    return f"{round(value, decimals) + 0.0:{'+' if sign else ''}.{decimals}f} m"


def _settings(main: ET.Element, record: Record) -> None:
    section = add(main, "section", class_="settings", aria_labelledby="settings")
    add(section, "h2", "Settings and versions", id="settings")
    facts = record.facts
    versions = f"plotly {plotly_version}, Python {platform.python_version()}"
    lines: Sequence[tuple[str, str]] = (
        ("replayed with", f"pipeline_tracker {facts.version}" if facts else "not known"),
        ("replay took", f"{facts.seconds:.1f} s" if facts else "not known"),
        ("report written with", f"pipeline_tracker {__version__}, {versions}"),
        ("again", f"pipeline-tracker report {_shown(record.directory)}"),
    )  # fmt: skip
    table = add(section, "dl", class_="values")
    for name, value in lines:
        pair = add(table, "div")
        add(pair, "dt", name)
        add(pair, "dd", value)
    details = add(section, "details")
    add(details, "summary", "settings.yaml: the same run again")
    add(details, "pre", record.settings_text)


def _shown(directory: Path) -> str:
    return directory.resolve().name
