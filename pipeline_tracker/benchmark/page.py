"""The table as one HTML page that needs nothing else; a click on a column sorts by it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree as ET

from pipeline_tracker import __version__
from pipeline_tracker.benchmark.columns import Column, all_columns
from pipeline_tracker.benchmark.lines import Line

_STYLE = """
body { font: 14px/1.4 system-ui, sans-serif; margin: 1.5em; color: #222; background: #fff }
h1 { font-size: 1.4em; margin: 0 }
div { overflow: auto; max-height: 85vh; border: 1px solid #ccc }
table { border-collapse: separate; border-spacing: 0; font-variant-numeric: tabular-nums }
th, td { padding: .25em .6em; border-bottom: 1px solid #e4e4e4; white-space: nowrap }
td.number { text-align: right }
thead th { position: sticky; background: #f2f4f6; font-weight: 600; z-index: 1 }
thead tr.groups th { top: 0; text-align: left; border-left: 1px solid #ccc; height: 1.5em }
thead tr.columns th { top: 2.05em; cursor: pointer; vertical-align: bottom }
tbody td:first-child, thead th:first-child { position: sticky; left: 0; background: #fff }
thead th:first-child { background: #f2f4f6; z-index: 2 }
tr.pooled td { font-weight: 600; background: #f8f9e8 !important }
tr.failed td { color: #a40000 } tr.missing td { color: #888 }
.unit { font-weight: 400; color: #666 }
"""
_SCRIPT = """
document.querySelectorAll('tr.columns th').forEach(function (head, place) {
  var up = false;
  head.addEventListener('click', function () {
    up = !up;
    var body = document.querySelector('tbody');
    var rows = Array.from(body.rows);
    rows.sort(function (a, b) {
      var x = a.cells[place].dataset.value, y = b.cells[place].dataset.value;
      if (x === undefined || y === undefined) {
        return (x === undefined) - (y === undefined);
      }
      var numbers = a.cells[place].className === 'number';
      var order = numbers ? x - y : x.localeCompare(y, undefined, {numeric: true});
      return up ? order : -order;
    });
    rows.forEach(function (row) { body.appendChild(row); });
  });
});
"""


def as_html(lines: Sequence[Line], manifest: Path, description: str) -> str:
    """Return the page."""
    title = f"Benchmark {manifest.stem}"
    html = ET.Element("html", lang="en")
    head, body = ET.SubElement(html, "head"), ET.SubElement(html, "body")
    ET.SubElement(head, "meta", charset="utf-8")
    ET.SubElement(head, "meta", name="viewport", content="width=device-width")
    ET.SubElement(head, "title").text = title
    ET.SubElement(head, "style").text = _STYLE
    ET.SubElement(body, "h1").text = title
    said = f"{description}. " if description else ""
    ET.SubElement(body, "p").text = (
        f"{said}pipeline_tracker {__version__}. Bold: all seeds together. "
        "A click on a column sorts by it; a pointer over it tells what it is."
    )
    table = ET.SubElement(ET.SubElement(body, "div"), "table")
    columns = all_columns()
    _head(table, columns)
    rows = ET.SubElement(table, "tbody")
    for line in lines:
        _row(rows, columns, line)
    ET.SubElement(body, "script").text = _SCRIPT
    return "<!DOCTYPE html>\n" + ET.tostring(html, encoding="unicode", method="html") + "\n"


def _head(table: ET.Element, columns: Sequence[Column]) -> None:
    head = ET.SubElement(table, "thead")
    groups = ET.SubElement(head, "tr", {"class": "groups"})
    for name, members in groupby(columns, key=lambda column: column.group):
        ET.SubElement(groups, "th", colspan=str(len(list(members)))).text = name
    names = ET.SubElement(head, "tr", {"class": "columns"})
    for column in columns:
        cell = ET.SubElement(names, "th", title=column.description)
        cell.text = column.title.replace("-able", "able").replace("base-", "base")
        if column.unit:
            cell.text += " "
            ET.SubElement(cell, "span", {"class": "unit"}).text = column.unit


def _row(rows: ET.Element, columns: Sequence[Column], line: Line) -> None:
    row = ET.SubElement(rows, "tr", {"class": line.state.replace("not done", "missing")})
    for column in columns:
        value = column.of(line)
        cell = ET.SubElement(row, "td")
        if isinstance(value, (int, float)):
            cell.set("class", "number")
        if value is not None:
            cell.set("data-value", str(value))
        cell.text = column.shown(line) if value is not None else ""
