"""A bag of unrectified images: simulated, replayed, measured, by the commands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.cli import run_command

pytest.importorskip("embreex", reason="the extra [sim] is not installed")

LENS = "camera.distortion={coefficients: [-0.28, 0.09, 0.001, -0.0015, -0.012], focal_share: 1.1}"


def test_the_replay_of_unrectified_images_is_measured(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, out = str(tmp_path / "raw"), str(tmp_path / "out")
    small = ["frames=3", "camera.width=480", "camera.height=320", LENS]
    arguments = [part for value in small for part in ("--set", value)]
    assert run_command(["simulate", "model_2m", "--output", bag, "--seed", "1", *arguments]) == 0
    pipe = ["--set", "pipe.diameter=0.6"]
    capfd.readouterr()
    assert run_command(["replay", bag, "--output", out, *pipe]) == 2
    assert "rectify it with --set camera.rectify=true" in capfd.readouterr().err
    rectify = ["--set", "camera.rectify=true"]
    assert run_command(["replay", bag, "--output", out, *pipe, *rectify]) == 0
    # The check that bag and replay belong together sees the same pictures.
    assert run_command(["evaluate", out, "--truth", bag, "--no-plots"]) == 0
    figures = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert figures["fit"]["images_compared"] == 3
    assert figures["counts"]["valid"] == 3
    assert figures["counts"]["false_valid"] == 0
    with BagReader(tmp_path / "out" / "result") as result:
        vectorized = result.first("/pipeline/vectorized")
    assert not vectorized.left_info.d.any()
    assert not vectorized.right_info.d.any()
