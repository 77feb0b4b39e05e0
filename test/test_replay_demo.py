"""The demo bag through the real pipeline."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.evaluation import evaluate
from pipeline_tracker.replay import replay
from pipeline_tracker.settings_io import load_settings

DEMO = Path(__file__).resolve().parents[1] / "bags" / "demo"


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("demo") / "out"
    settings = load_settings(overrides=["pipe.diameter=0.6"])
    assert replay(DEMO, settings, output, stream=io.StringIO()).summary.found
    return output


def rows(output: Path) -> list[dict[str, str]]:
    with (output / "estimates.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_pipe_is_followed(output: Path) -> None:
    with BagReader(DEMO) as bag:
        left = next(t for t in bag.topics.values() if "left/image" in t.name)
    table = rows(output)
    assert len(table) == left.count
    assert sum(row["valid"] == "1" for row in table) >= 0.9 * len(table)
    assert sum(row["mode"] == "tracking" for row in table) >= 0.8 * len(table)
    chainages = [float(row["chainage"]) for row in table if row["chainage"]]
    assert chainages == sorted(chainages)


def test_pipe_is_where_it_is(output: Path) -> None:
    evaluation = evaluate(output, DEMO)
    figures = evaluation.groups["all"].divergence
    assert figures is not None
    assert figures.horizontal.mean < 0.02
    assert figures.vertical.mean < 0.02
    assert evaluation.counts.false_valid == 0


def test_again_by_its_own_settings_gives_the_same_bytes(output: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    replay(DEMO, load_settings(output / "settings.yaml"), again, stream=io.StringIO())
    for first, second in zip(rows(output), rows(again), strict=True):
        first.pop("processing_ms")
        second.pop("processing_ms")
        assert first == second
