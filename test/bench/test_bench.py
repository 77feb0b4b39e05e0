"""`bench`: what it writes, and what it refuses. No time is judged."""

from __future__ import annotations

import io
import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rich.console import Console

from pipeline_tracker.bench import BenchOptions, BenchReport, bench_command
from pipeline_tracker.bench import command as command_module
from pipeline_tracker.bench.growth import measure_growth
from pipeline_tracker.bench.live import LOADS
from pipeline_tracker.bench.measure import profile_pair
from pipeline_tracker.bench.memory import measure_memory
from pipeline_tracker.bench.options import REFERENCE, SIZES, parse_sizes
from pipeline_tracker.bench.plots import FLAME, GROWTH, write_plots
from pipeline_tracker.bench.recording import Recording, read_recording, to_and_fro
from pipeline_tracker.bench.sampling import sample
from pipeline_tracker.bench.schema import bench_schema
from pipeline_tracker.bench.tables import print_report
from pipeline_tracker.cli import run_command
from pipeline_tracker.evaluation.document import tables_of

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "bags" / "demo"
SIZE = (480, 320)


@pytest.fixture(scope="module")
def demo() -> Recording:
    return read_recording(DEMO, ("pipe.diameter=0.6",))


@pytest.fixture(scope="module")
def short() -> Any:
    """Let the samples be taken for a moment only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command_module, "profile_pair", lambda rec: profile_pair(rec, 0.2))
        yield


@pytest.fixture(scope="module")
def written(short: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:  # noqa: ARG001
    file = tmp_path_factory.mktemp("bench") / "bench.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        code = run_command(["bench", "--sizes", "480x320", "--repeat", "2", "--json", str(file)])
    assert code == 0
    document: dict[str, Any] = json.loads(file.read_text())
    return document


def test_the_json_has_the_keys_of_the_contract_first(written: dict[str, Any]) -> None:
    assert list(written)[:4] == ["pair_ms", "stock_pair_ms", "ratio", "stock_skeleton"]
    assert set(written) == set(bench_schema()["properties"])
    assert BenchReport.model_validate(written).bag == "demo"


def test_the_keys_at_the_top_are_those_of_1200_x_800_alone(written: dict[str, Any]) -> None:
    assert [written[k] for k in ("pair_ms", "stock_pair_ms", "ratio")] == [None, None, None]


def test_ratios_are_those_of_the_medians(written: dict[str, Any]) -> None:
    (size,) = written["sizes"]
    timings = size["timings"]
    stock = timings["stock"]["median_ms"]
    assert size["pair_ms"] == timings["pair"]["median_ms"]
    assert size["stock_pair_ms"] == stock
    assert size["ratio"] == pytest.approx(stock / size["pair_ms"])
    for timing in timings.values():
        if timing["median_ms"] is not None:
            assert timing["ratio"] == pytest.approx(stock / timing["median_ms"])
            assert timing["min_ms"] <= timing["median_ms"] <= timing["p95_ms"]
    pixel, modified = (timings[f"hough_{k}"]["median_ms"] for k in ("pixel", "modified"))
    assert size["hough_ratio"] == pytest.approx(pixel / modified)


def test_the_chain_s_steps_make_up_the_chain(written: dict[str, Any]) -> None:
    (size,) = written["sizes"]
    steps = size["stock_steps_ms"]
    assert list(steps) == ["clahe", "canny", "skeleton", "contours_polygons"]
    assert min(steps.values()) > 0.0
    assert sum(steps.values()) <= 1.01 * size["timings"]["stock"]["p95_ms"]


def test_every_step_is_measured(written: dict[str, Any]) -> None:
    timings = written["sizes"][0]["timings"]
    expected = {"vectorize", "vectorize_match", "stock", "lsd", "hough_p"}
    expected |= {"hough_modified", "hough_pixel", "voting"}
    expected |= {f"recognition_{k}" for k in (1, 2, 3, 4, "auto")}
    expected |= {"tracking_vote", "tracking_fit", "pair_vote", "pair", "pair_recognition"}
    assert set(timings) - {"edlines"} == expected
    assert ("edlines" in timings) == hasattr(cv2, "ximgproc")
    assert {t["rounds"] for t in timings.values()} == {2}
    # The pipe is found and followed at this size: the times are not those of giving up.
    for key in ("pair", "pair_recognition", "tracking_fit", "recognition_4", "voting"):
        assert timings[key]["counted"] == 2


def test_shares_are_parts_of_their_callers(written: dict[str, Any]) -> None:
    shares = {tuple(step["path"]): step["share"] for step in written["shares"]["steps"]}
    assert any(path[0].endswith("process") for path in shares)
    for path, share in shares.items():
        inside = sum(s for p, s in shares.items() if p[:-1] == path)
        assert inside <= share + 1e-9 <= 1.0 + 2e-9
        assert path[:-1] in shares or len(path) == 1


def test_the_table_fits_80_columns_and_tells_the_skeleton(written: dict[str, Any]) -> None:
    report = BenchReport.model_validate(written)
    console = Console(width=80, record=True, file=io.StringIO())
    print_report(report, console)
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 80
    assert report.stock_skeleton in text
    assert "load average before" in text
    for timing in report.sizes[0].timings.values():
        assert timing.label in text
    without = report.model_copy(update={"stock_skeleton": "none"})
    print_report(without, console)
    assert "without skeletonization" in console.export_text()


def test_at_1200_x_800_the_top_has_the_figures(
    short: None,  # noqa: ARG001
    demo: Recording,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The reference is named small, so that the test is short.
    monkeypatch.setattr(command_module, "REFERENCE", SIZE)
    monkeypatch.setattr(command_module, "read_recording", lambda *_: demo)
    options = BenchOptions(sizes=(SIZE,), repeat=1)
    quiet = Console(quiet=True)
    report = bench_command(options, console=quiet, progress=quiet)
    (size,) = report.sizes
    assert (report.pair_ms, report.stock_pair_ms) == (size.pair_ms, size.stock_pair_ms)
    assert report.pair_ms is not None
    assert report.stock_pair_ms is not None
    assert report.ratio == report.stock_pair_ms / report.pair_ms


def test_live_figures_fit_the_table_too(written: dict[str, Any]) -> None:
    row = {
        "hertz": 20.0, "processes": 4, "one_core": False, "ready_s": 12.34, "published": 400,
        "answered": 300, "valid": 299, "dropped": 100, "first_ms": None, "p50_ms": 1234.5,
        "p99_ms": 2345.6, "max_ms": 3456.7, "load": 7.25, "cpu_percent": 199.5, "memory_mb": 1270.4,
    }  # fmt: skip
    live = {"width": 1200, "height": 800, "ready_cold_s": 33.3, "rows": [row, {**row, "load": 3.5}]}
    report = BenchReport.model_validate({**written, "live": live})
    console = Console(width=80, record=True, file=io.StringIO())
    print_report(report, console)
    text = console.export_text()
    for figure in ("12.3", "1234", "2346", "100/400", "200", "1270", "3.5 to 7.2", "33.3 s"):
        assert figure in text
    assert max(map(len, text.splitlines())) <= 80


def test_the_page_has_the_tables_of_the_schema() -> None:
    """Renew it with ``python -m pipeline_tracker.bench.document``."""
    page = (ROOT / "docs" / "bench.md").read_text()
    assert page.split("## Schema\n\n")[1].rstrip() == tables_of(bench_schema()).rstrip()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--images", "/no/such/bag"], "/no/such/bag: no such file"),
        (["--images", str(DEMO)], "pipe.diameter"),
        (["--sizes", "large"], "--sizes large: expected WIDTHxHEIGHT"),
        (["--sizes", "640x480,"], "--sizes 640x480,: expected WIDTHxHEIGHT"),
        (["--sizes", "-640x480"], "--sizes -640x480: expected WIDTHxHEIGHT"),
        (["--sizes", "640x10"], "--sizes 640x10: expected sides of 160 to 8192 px"),
        (["--sizes", "99999x9999"], "expected sides of 160 to 8192 px"),
        (["--repeat", "0"], "--repeat 0: expected 1 to"),
        (["--repeat", "two"], "--repeat two: expected an integer"),
        (["--frames", "3"], "--frames 3: expected 20 to"),
        (["--json", "/no/such/directory/x.json"], "cannot be written"),
        (["--plots", __file__], "is a file, expected a directory"),
        (["--set", "pipe.diameter=nan"], "pipe.diameter"),
    ],
)
def test_bad_input_is_one_line_and_code_2(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["bench", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_demo_that_is_not_there_names_the_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # As in a wheel, which has no tree around it.
    monkeypatch.setattr(
        "pipeline_tracker.resources.__file__", str(tmp_path / "site" / "pipeline_tracker" / "r.py")
    )
    assert run_command(["bench"]) == 2
    assert "--images" in capsys.readouterr().err


def test_what_is_not_installed_is_told_before_anything_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pipeline_tracker.bench.memory.find_spec", lambda _: None)
    monkeypatch.setattr(command_module, "_measure", lambda *_: pytest.fail("measured"))
    assert run_command(["bench", "--frames", "20"]) == 2
    assert "pip install '.[bench]'" in capsys.readouterr().err


def test_sizes_are_read_once_each_and_the_main_one_is_1200_x_800() -> None:
    assert parse_sizes("640x480, 1200X800".lower()) == ((640, 480), (1200, 800))
    assert parse_sizes("640x480,640x480") == ((640, 480),)
    assert BenchOptions().sizes == SIZES
    assert BenchOptions().main_size == REFERENCE
    assert BenchOptions(sizes=((640, 480),)).main_size == (640, 480)
    assert BenchOptions().rounds((1200, 800)) > BenchOptions().rounds((4008, 2672))


@pytest.mark.parametrize("size", [(480, 320), (400, 400), (1100, 420)])
def test_the_calibration_follows_the_images(demo: Recording, size: tuple[int, int]) -> None:
    resized = demo.resized(size)
    assert resized.size == size
    assert resized.pairs[0].left.shape == (size[1], size[0])
    old, new = demo.rig.left, resized.rig.left
    scale = new.fx / old.fx
    assert new.fy / old.fy == pytest.approx(scale, rel=3e-3)
    # A blob keeps its ray. Its middle is a whole number of pixels in the enlarged picture too.
    picture = np.zeros((old.height, old.width), np.uint8)
    picture[330:350, 500:520] = 255
    dotted = replace(demo, pairs=(replace(demo.pairs[0], left=picture), *demo.pairs[1:]))
    shown = dotted.resized(size).pairs[0].left.astype(float)
    ys, xs = np.mgrid[0 : size[1], 0 : size[0]]
    seen = [float((shown * k).sum() / shown.sum()) for k in (xs, ys)]
    np.testing.assert_allclose(new.rays(seen), old.rays([509.5, 339.5]), atol=2e-4)


def test_the_way_to_and_fro_has_no_jumps(demo: Recording) -> None:
    way = to_and_fro(demo)
    stops = [next(way) for _ in range(3 * len(demo.pairs))]
    stamps = [stamp for stop in stops for stamp, _ in stop.poses]
    assert stamps == sorted(set(stamps))
    assert [stop.stamp_ns for stop in stops] == [stop.poses[-1][0] for stop in stops]
    steps = [
        np.linalg.norm(b.pair.pose.translation - a.pair.pose.translation)
        for a, b in itertools.pairwise(stops)
    ]
    assert min(steps) > 0.0
    assert max(steps) < 1.0
    # The turn at the far end goes through neither of its neighbours twice.
    assert stops[len(demo.pairs)].pair is stops[len(demo.pairs) - 2].pair


def test_memory_is_looked_at_over_all_pairs(demo: Recording) -> None:
    pytest.importorskip("psutil")
    memory = measure_memory(demo.resized(SIZE), 30)
    assert memory.frames == 30
    assert memory.tracked >= 25
    assert 0.0 < memory.start_mb <= memory.most_mb
    assert memory.end_mb <= memory.most_mb


def test_growth_and_flames_are_drawn(
    demo: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline_tracker.bench.growth._SIZES", ((321, 214), (480, 320)))
    monkeypatch.setattr("pipeline_tracker.bench.growth._COUNTS", (100, 400))
    monkeypatch.setattr("pipeline_tracker.bench.growth._ROUNDS", 1)
    growth = measure_growth(demo, SIZE)
    assert {line.unit for line in growth} == {"pixels", "segments"}
    for line in growth:
        slope = np.log(line.ms[1] / line.ms[0]) / np.log(line.x[1] / line.x[0])
        assert line.exponent == pytest.approx(slope)
    profile = profile_pair(demo.resized(SIZE), 0.2)
    for path, name in zip(write_plots(growth, profile, tmp_path), (GROWTH, FLAME), strict=True):
        assert path == tmp_path / name
        picture = cv2.imread(str(path))
        assert picture is not None
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def test_outside_of_a_pair_nothing_is_sampled() -> None:
    profile = sample(lambda: sum(range(1000)), 0.05)
    assert profile.pairs > 0
    assert profile.samples == 0
    assert profile.shares(SIZE).steps == []


def test_loads_are_both_rates_in_one_process_and_four() -> None:
    assert {(load.hertz, load.processes) for load in LOADS} == {
        (10.0, 1), (10.0, 4), (20.0, 1), (20.0, 4),
    }  # fmt: skip
    assert any(load.one_core and load.hertz == 20.0 and load.processes == 1 for load in LOADS)
