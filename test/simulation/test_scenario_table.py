from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from pipeline_tracker.simulation.scenario_files import list_scenarios
from pipeline_tracker.simulation.scenario_table import scenario_table

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_table_in_the_docs_is_up_to_date() -> None:
    assert (DOCS / "scenarios.md").read_text() == scenario_table(), (
        "python -m pipeline_tracker.simulation.scenario_table > docs/scenarios.md"
    )


def test_the_table_tells_each_scenarios_geometry() -> None:
    lines = scenario_table().splitlines()
    for name in list_scenarios():
        what, geometry = (line for line in lines if line.startswith(f"| `{name}` |"))
        assert list_scenarios()[name] in what
        assert "° forward" in geometry
    clear = next(line for line in lines if line.startswith("| `clear` | 20"))
    assert "| 20 x 0.35 | 1200 x 800 | 65.5° | 0.2 | (0.3, 0.1, -0.1), 30° forward | 2 |" in clear
    assert "(0.45, 0.45, -0.05) 50°; (0.45, -0.45, -0.05) 50°" in clear


def test_the_table_is_written_by_a_command() -> None:
    command = [sys.executable, "-m", "pipeline_tracker.simulation.scenario_table"]
    done = subprocess.run(command, capture_output=True, check=True)
    assert done.stdout.decode() == scenario_table()
