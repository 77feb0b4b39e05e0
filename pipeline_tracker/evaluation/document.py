"""The schema of ``evaluation.json`` as a table for people.

``python -m pipeline_tracker.evaluation.document`` prints it.
"""

from __future__ import annotations

import sys
from typing import Any

from pipeline_tracker.evaluation.schema import evaluation_schema


def schema_tables() -> str:
    """Return Markdown: a table for each object of ``evaluation.json``, the whole first."""
    return tables_of(evaluation_schema())


def tables_of(schema: dict[str, Any]) -> str:
    """Return a JSON Schema as Markdown: a table for each object, the whole first."""
    objects = {schema["title"]: schema, **schema["$defs"]}
    return "\n".join(_table(name, part) for name, part in objects.items())


def _table(name: str, part: dict[str, Any]) -> str:
    rows = [
        f"| `{field}` | {_type(what)} | {what.get('description', '')} |"
        for field, what in part["properties"].items()
    ]
    text = " ".join(part["description"].split())
    return "\n".join(
        [f"### {name}", "", text, "", "| field | type | meaning |", "|---|---|---|", *rows, ""]
    )


def _type(what: dict[str, Any]) -> str:
    if "anyOf" in what:
        return " or ".join(_type(part) for part in what["anyOf"])
    if "$ref" in what:
        name = what["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    if what["type"] == "array":
        return f"list of {_type(what['items'])}"
    inside = what.get("additionalProperties")
    if isinstance(inside, dict):
        return f"object of {_type(inside)}"
    return str(what["type"])


if __name__ == "__main__":
    sys.stdout.write(schema_tables())
