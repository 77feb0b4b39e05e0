"""What the README says is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pipeline_tracker.settings_io import settings_table

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()


def test_table_of_settings_is_that_of_the_model() -> None:
    """Renew it with ``python -m pipeline_tracker.settings_io table``."""
    found = re.search(r"<!-- settings -->\n(.*?)<!-- end of settings -->", README, re.DOTALL)
    assert found is not None
    assert found[1] == settings_table()


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\]\(([^)#:]+)\)", README))))
def test_links_lead_to_files(target: str) -> None:
    assert (ROOT / target).exists()


def test_every_command_is_in_the_table() -> None:
    from pipeline_tracker.cli import app

    table = README.split("## Commands")[1].split("## ")[0]
    named = {re.match(r"\| `([a-z]+)", line)[1] for line in table.splitlines() if "| `" in line[:4]}
    assert named == {command.callback.__name__ for command in app.registered_commands}
