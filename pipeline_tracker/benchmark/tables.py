"""The table for other programs: CSV and JSON; and what its columns mean, for the docs."""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline_tracker import __version__
from pipeline_tracker.benchmark.columns import all_columns
from pipeline_tracker.benchmark.lines import Line

SCHEMA_VERSION = 1


def as_records(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return the lines as keys and values."""
    columns = all_columns()
    return [{column.key: column.of(line) for column in columns} for line in lines]


def as_csv(lines: Sequence[Line]) -> str:
    """Return the table as CSV; what is not known is an empty cell."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [column.key for column in all_columns()], lineterminator="\n")
    writer.writeheader()
    writer.writerows(as_records(lines))
    return stream.getvalue()


def as_json(lines: Sequence[Line], manifest: Path, description: str) -> str:
    """Return the table as JSON with the meaning of its columns."""
    document = {
        "schema_version": SCHEMA_VERSION,
        "pipeline_tracker": __version__,
        "manifest": manifest.name,
        "description": description,
        "columns": {
            column.key: {"unit": column.unit, "description": column.description}
            for column in all_columns()
        },
        "lines": as_records(lines),
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def as_markdown() -> str:
    """Return a Markdown table of the columns, for the docs."""
    rows = ["| column | unit | meaning |", "|---|---|---|"]
    rows += [f"| `{c.key}` | {c.unit} | {c.description} |" for c in all_columns()]
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(as_markdown())
