"""The description of evaluation.json is that of its schema."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline_tracker.cli import run_command
from pipeline_tracker.evaluation import FILE_NAME, evaluation_schema
from pipeline_tracker.evaluation.document import schema_tables
from pipeline_tracker.evaluation.plots import PLOTS
from pipeline_tracker.replay.runner import OUR_FILES

PAGE = Path(__file__).resolve().parents[2] / "docs/evaluation.md"


def test_the_page_has_the_tables_of_the_schema() -> None:
    """Renew them with ``python -m pipeline_tracker.evaluation.document``."""
    assert PAGE.read_text().split("## Schema\n\n")[1].rstrip() == schema_tables().rstrip()


def test_every_field_is_described() -> None:
    schema = evaluation_schema()
    for part in (schema, *schema["$defs"].values()):
        for name, field in part["properties"].items():
            assert field.get("description"), name


def test_the_command_prints_the_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["evaluate", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == evaluation_schema()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [([], "no DIR given"), (["out"], "no --truth given"), (["--truth", "bag"], "no DIR given")],
)
def test_what_is_missing_is_said(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["evaluate", *arguments]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def test_all_that_is_written_is_named_and_replaced_by_a_new_replay() -> None:
    page = PAGE.read_text()
    for name in (FILE_NAME, *PLOTS):
        assert f"`{name}`" in page
        assert name in OUR_FILES
