from __future__ import annotations

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.console import Console

from pipeline_tracker.benchmark.columns import all_columns
from pipeline_tracker.benchmark.figures import Figures, Stat
from pipeline_tracker.benchmark.geometry import Geometry
from pipeline_tracker.benchmark.lines import Line
from pipeline_tracker.benchmark.page import as_html
from pipeline_tracker.benchmark.tables import as_csv, as_json, as_markdown
from pipeline_tracker.benchmark.terminal import print_tables

ROOT = Path(__file__).resolve().parents[2]
NASTY = 'the <b>"disk"</b>, & all; [red]it\'s full[/red] </script> é'
GEOMETRY = Geometry(
    width=1200,
    height=800,
    field_of_view=65.5,
    baseline=0.2,
    translation=(0.3, 0.1, -0.1),
    rotation=(-150.0, 0.0, -90.0),
    lamps=((0.5, 0.0, -0.05), (0.5, 1.0, -0.05)),
    distance=2.0,
    diameter=0.6,
)


@pytest.fixture
def lines() -> list[Line]:
    figures = Figures(
        {"frames": 20, "valid": 15, "detectable": 16, "detectable_valid": 14, "false_valid": 1},
        {"end": 1},
        {
            "horizontal": Stat(15, 0.0012345, None, 0.031),
            "vertical": Stat(15, 0.01, None, 0.02),
            "heading_misalignment": Stat(15, -0.01, 0.02, -0.05),
            "covered": Stat(15, 0.8),
        },
    )
    return [
        Line("calm", "1", "default", "done", GEOMETRY, "", figures, 30.0, 2.5, 90.0),
        Line("calm", "2", "default", "failed", GEOMETRY, NASTY),
        Line("calm", "1 of 2 seeds", "default", "pooled", GEOMETRY, "", figures, 30.0, 2.5, 90.0),
        Line("bag", "", "default", "not done", Geometry()),
    ]


def check(records: list[dict[str, object]], number: type) -> None:
    assert [record["state"] for record in records] == ["done", "failed", "pooled", "not done"]
    done, failed = records[:2]
    assert number(done["frames"]) == 20
    assert number(done["valid_percent"]) == 75.0
    assert number(done["detectable_valid_percent"]) == 87.5
    assert number(done["horizontal_mean_cm"]) == pytest.approx(0.12345)
    assert number(done["heading_mean_deg"]) == pytest.approx(-0.57296, abs=1e-5)
    assert number(done["median_ms"]) == 90.0
    assert failed["reason"] == NASTY
    for record in (done, failed):
        assert record["camera"] == "1200 x 800"
        assert number(record["baseline_m"]) == 0.2
        assert record["mounting"] == "0.3 0.1 -0.1; -150 0 -90"
        assert record["lamps"] == "0.5 0 -0.05; 0.5 1 -0.05"


def test_csv_reads_back(lines: list[Line]) -> None:
    records = list(csv.DictReader(io.StringIO(as_csv(lines))))
    check(records, float)
    assert records[1]["frames"] == ""
    assert records[3]["baseline_m"] == ""


def test_json_reads_back(lines: list[Line]) -> None:
    document = json.loads(as_json(lines, Path("calm.yaml"), "words"))
    check(document["lines"], float)
    assert document["lines"][1]["frames"] is None
    assert document["description"] == "words"
    assert document["manifest"] == "calm.yaml"
    for record in document["lines"]:
        assert list(record) == list(document["columns"])


class _Cells(HTMLParser):
    """Collects the rows of the page, and all tags that it uses."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.values: list[str | None] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.values.append(dict(attrs).get("data-value"))

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1] and "script" not in self.tags:
            self.rows[-1][-1] += data


def test_html_reads_back(lines: list[Line]) -> None:
    text = as_html(lines, Path("calm.yaml"), NASTY)
    page = _Cells()
    page.feed(text)
    _, names, *rows = page.rows
    assert len(names) == len(all_columns())
    assert [len(row) for row in rows] == [len(all_columns())] * 4
    assert rows[1][4] == NASTY
    assert "b" not in page.tags
    assert page.tags.count("script") == 1
    assert NASTY in page.values
    # Nothing is loaded from elsewhere.
    assert not re.search(r"(src|href)=|url\(|https?:", text)


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_a_terminal_of_any_width_shows_every_figure(lines: list[Line], width: int) -> None:
    stream = io.StringIO()
    print_tables(lines, Console(file=stream, width=width, force_terminal=True, no_color=True))
    shown = re.sub(r"\x1b\[[0-9;]*m", "", stream.getvalue())
    assert max(map(len, shown.splitlines())) <= width
    for text in ("75.0", "87.5", "0.12/3.10", "-0.57/1.15", "80.0", "30.0", "0.200"):
        assert text in shown, text
    assert "calm 1 of 2 seeds default" in shown
    for word in ("failed: the", "[red]it's", "full[/red]", "done"):
        assert word in " ".join(shown.split()), word


def test_columns_are_described_in_the_docs() -> None:
    """Renew it with ``python -m pipeline_tracker.benchmark.tables``."""
    text = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    found = re.search(r"<!-- columns -->\n(.*?)<!-- end of columns -->", text, re.DOTALL)
    assert found is not None
    assert found[1] == as_markdown()


def test_column_names_are_unique() -> None:
    keys = [column.key for column in all_columns()]
    assert len(set(keys)) == len(keys)
