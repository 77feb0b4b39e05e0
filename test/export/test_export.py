"""Exports: tables that pandas reads, and a map by RFC 7946 that lies where the pipe lies."""

from __future__ import annotations

import io
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pandas as pd
import pytest
from bag_maker import SECOND, Sea, pose_item, write_bag
from stand_in import StandIn

from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.export import ExportOutcome, export
from pipeline_tracker.export.tables import COLUMNS
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.replay import replay
from pipeline_tracker.settings_io import settings_from_values

ORIGIN = "export.origin=[43.1,131.9,-60.0]"
# Frame 3 shows no pipe.
SEA = Sea(frames=8, period=1.0, level=lambda i: 50 if i == 3 else 150)

_POSITION = {
    "type": "array",
    "minItems": 3,
    "maxItems": 3,
    "prefixItems": [
        {"type": "number", "minimum": -180, "maximum": 180},
        {"type": "number", "minimum": -90, "maximum": 90},
        {"type": "number"},
    ],
}
# What RFC 7946 says of collections of points and lines.
SCHEMA = {
    "type": "object",
    "required": ["type", "features"],
    "not": {"required": ["crs"]},
    "properties": {
        "type": {"const": "FeatureCollection"},
        "features": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["type", "geometry", "properties"],
                "properties": {
                    "type": {"const": "Feature"},
                    "properties": {"type": "object"},
                    "geometry": {
                        "oneOf": [
                            {"type": "null"},
                            {
                                "type": "object",
                                "required": ["type", "coordinates"],
                                "additionalProperties": False,
                                "properties": {
                                    "type": {"const": "Point"},
                                    "coordinates": _POSITION,
                                },
                            },
                            {
                                "type": "object",
                                "required": ["type", "coordinates"],
                                "additionalProperties": False,
                                "properties": {
                                    "type": {"const": "LineString"},
                                    "coordinates": {
                                        "type": "array",
                                        "minItems": 2,
                                        "items": _POSITION,
                                    },
                                },
                            },
                        ]
                    },
                },
            },
        },
    },
}


def replayed(place: Path, items: Any = None) -> Path:
    bag = write_bag(place / "bag", SEA.items() if items is None else items)
    settings = settings_from_values({"pipe.diameter": 0.6})
    done = replay(bag, settings, place / "out", stream=io.StringIO(), make_pipeline=StandIn)
    return done.output


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return replayed(tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="module")
def tables(out: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pd.DataFrame]:
    place = tmp_path_factory.mktemp("tables") / "new"
    export(out, "csv", place, [ORIGIN])
    return {path.stem: pd.read_csv(path) for path in place.iterdir()}


@pytest.fixture(scope="module")
def features(out: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    path = tmp_path_factory.mktemp("map") / "pipe.geojson"
    export(out, "geojson", path, [ORIGIN])
    document = json.loads(path.read_text())
    jsonschema.validate(document, SCHEMA, cls=jsonschema.Draft202012Validator)
    return list(document["features"])


def of_kind(features: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [f for f in features if f["properties"]["kind"] == kind]


# Tables.


def test_pandas_reads_numbers(tables: dict[str, pd.DataFrame]) -> None:
    assert {name: tuple(table.columns) for name, table in tables.items()} == COLUMNS
    line = tables["centreline"]
    assert line["stamp_ns"].dtype == np.int64
    text = {"event", "reason", "reasons", "course", "lie"}
    for table in tables.values():
        for name in set(table.columns) - text:
            assert pd.api.types.is_numeric_dtype(table[name]), name


def test_centreline_is_the_axis_in_odom(tables: dict[str, pd.DataFrame]) -> None:
    line = tables["centreline"]
    assert list(line["frame"]) == [1, 2, 3, 5, 6, 7, 8], "those that are valid"
    assert list(line["stamp_ns"]) == [SEA.stamp(i) for i in (0, 1, 2, 4, 5, 6, 7)]
    for index, row in zip((0, 1, 2, 4, 5, 6, 7), line.itertuples(), strict=True):
        # The stand-in's segment lies from 1.0 to 1.5 m ahead; the vehicle looks 0.1 rad to port.
        pose = Pose.from_rpy([0.2 * index, 0.0, 0.0], [0.0, 0.0, 0.1])
        aside = (row.y - pose.apply(np.array([1.25, 0.0, -2.0]))[1]) / math.cos(0.1)
        middle = pose.apply(np.array([1.25, aside, -2.0]))
        assert (row.x, row.y, row.z) == pytest.approx(tuple(middle), abs=1e-6)
        assert row.sigma_left == row.sigma_up == pytest.approx(0.01)
    # 1.25 m ahead of the vehicle, along the pipe.
    ahead = line["chainage"] - line["vehicle_chainage"]
    assert np.allclose(ahead, 1.25, atol=0.02)
    assert list(line["vehicle_chainage"]) == pytest.approx([0.0, 0.2, 0.4, 0.8, 1.0, 1.2, 1.4])


def test_stretches_are_those_of_the_report(tables: dict[str, pd.DataFrame]) -> None:
    stretches = tables["stretches"]
    assert list(stretches["course"]) == ["followed", "searching", "followed"]
    assert list(zip(stretches["first_frame"], stretches["last_frame"], strict=True)) == [
        (1, 3),
        (4, 4),
        (5, 8),
    ]
    assert stretches["reasons"][1] == "too dark (1)"
    assert stretches["length"][0] == pytest.approx(0.4)
    assert list(stretches["end_s"]) == [2.0, 3.0, 7.0]


def test_events_tell_what_happened(tables: dict[str, pd.DataFrame]) -> None:
    events = tables["events"]
    assert list(zip(events["frame"], events["event"], strict=True)) == [
        (1, "found"),
        (4, "lost"),
        (5, "found"),
    ]
    assert events["reason"][1] == "too dark"
    assert events["x"][1] == pytest.approx(0.6), "where the vehicle was"


def test_resets_and_jumps_are_events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Jumping(StandIn):
        """Says of frame 4 what the tracker says after a jump of the pose."""

        def process(self, *arguments: Any, **options: Any) -> FrameResult:
            if len(self.calls) == 4:
                self.resets.append("pose_jump")
            done = super().process(*arguments, **options)
            if len(self.calls) != 5:
                return done
            status = replace(done.tracked.status, reason="pose_jump, no_pose")
            return replace(done, tracked=replace(done.tracked, status=status))

    monkeypatch.setattr(sys.modules[__name__], "StandIn", Jumping)
    items = replace(SEA, level=lambda _: 150).items()
    done = export(replayed(tmp_path, items), "csv")
    assert [(e["frame"], e["event"]) for e in done.tables.events] == [
        (1, "found"),
        (5, "pose_jump"),
        (5, "reset"),
    ]
    runs = [row["run"] for row in done.tables.centreline]
    assert runs == [0, 0, 0, 0, 1, 1, 1, 1]


def test_without_an_origin_tables_have_no_place_on_the_earth(out: Path, tmp_path: Path) -> None:
    export(out, "csv", tmp_path)
    line = pd.read_csv(tmp_path / "centreline.csv")
    assert line[["latitude", "longitude", "height"]].isna().all(axis=None)
    assert line[["x", "y", "z", "chainage"]].notna().all(axis=None)


def test_without_poses_there_is_nothing_to_place(tmp_path: Path) -> None:
    place = replayed(tmp_path, [i for i in SEA.items() if i.topic != "/vnm/pose"])
    done = export(place, "csv")
    assert (len(done.tables.centreline), len(done.tables.stretches)) == (0, 3)
    assert pd.read_csv(place / "centreline.csv").empty
    with pytest.raises(PipelineTrackerError, match="nothing to place on a map; use --format csv"):
        export(place, "geojson", None, [ORIGIN])


# Maps.


def test_a_line_for_each_unbroken_part(features: list[dict[str, Any]]) -> None:
    lines = of_kind(features, "centreline")
    assert [f["geometry"]["type"] for f in lines] == ["LineString"] * 2
    assert [len(f["geometry"]["coordinates"]) for f in lines] == [3, 4]
    assert [f["properties"]["first_frame"] for f in lines] == [1, 5]
    stretches = of_kind(features, "stretch")
    assert [f["geometry"] is None for f in stretches] == [False, True, False]
    assert stretches[1]["properties"]["reasons"] == "too dark (1)"
    points = of_kind(features, "centreline_point")
    assert [p["geometry"]["coordinates"] for p in points] == [
        position for line in lines for position in line["geometry"]["coordinates"]
    ]
    assert [f["properties"]["event"] for f in of_kind(features, "event")] == [
        "found",
        "lost",
        "found",
    ]


def test_positions_are_longitude_latitude_height(
    features: list[dict[str, Any]], tables: dict[str, pd.DataFrame]
) -> None:
    points = np.array([f["geometry"]["coordinates"] for f in of_kind(features, "centreline_point")])
    line = tables["centreline"]
    assert points == pytest.approx(line[["longitude", "latitude", "height"]].to_numpy(), abs=1e-4)
    assert np.abs(points[:, :2] - (131.9, 43.1)).max() < 1e-4


@pytest.mark.parametrize("yaw", [0.0, 0.7, -math.pi / 2])
def test_places_are_those_of_the_ellipsoid(out: Path, tmp_path: Path, yaw: float) -> None:
    """East and north by radii of curvature, which are exact to a micrometre over some metres."""
    done = export(out, "csv", tmp_path, [ORIGIN, f"export.yaw={yaw}"])
    latitude = math.radians(43.1)
    a, e2 = 6378137.0, 0.00669437999014
    w = math.sqrt(1.0 - e2 * math.sin(latitude) ** 2)
    for row in done.tables.centreline:
        east = row["x"] * math.cos(yaw) - row["y"] * math.sin(yaw)
        north = row["x"] * math.sin(yaw) + row["y"] * math.cos(yaw)
        up = -60.0 + row["z"]
        east_radius = (a / w + up) * math.cos(latitude)
        north_radius = a * (1.0 - e2) / w**3 + up
        assert math.radians(row["longitude"] - 131.9) * east_radius == pytest.approx(east, abs=1e-5)
        assert math.radians(row["latitude"] - 43.1) * north_radius == pytest.approx(north, abs=1e-5)
        assert row["height"] == pytest.approx(up, abs=1e-5)


def test_a_single_frame_is_a_point_and_no_line(tmp_path: Path) -> None:
    place = replayed(tmp_path, replace(SEA, level=lambda i: 150 if i == 2 else 50).items())
    export(place, "geojson", None, [ORIGIN])
    document = json.loads((place / "pipe.geojson").read_text())
    jsonschema.validate(document, SCHEMA, cls=jsonschema.Draft202012Validator)
    kinds = [f["properties"]["kind"] for f in document["features"]]
    assert kinds.count("centreline") == 0
    assert kinds.count("centreline_point") == 1


# What is refused.


def test_geojson_without_an_origin_says_the_way_out(out: Path) -> None:
    with pytest.raises(PipelineTrackerError, match=r"--set export\.origin=\[LAT,LON,HEIGHT\].*csv"):
        export(out, "geojson")
    assert not (out / "pipe.geojson").exists()


@pytest.mark.parametrize("value", ["[91,0,0]", "[0,181,0]", "[.nan,0,0]", "[1,2]", "north"])
def test_places_that_are_none(out: Path, value: str) -> None:
    with pytest.raises(PipelineTrackerError, match=r"export\.origin"):
        export(out, "geojson", None, [f"export.origin={value}"])


def test_pyproj_is_named_where_it_is_missing(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(PipelineTrackerError, match=r"pip install '\.\[export\]'"):
        export(out, "geojson", tmp_path / "x", [ORIGIN])
    assert isinstance(export(out, "csv", tmp_path), ExportOutcome), "tables do without"


def test_what_is_there_is_not_replaced(out: Path, tmp_path: Path) -> None:
    export(out, "csv", tmp_path)
    with pytest.raises(PipelineTrackerError, match="is there already"):
        export(out, "csv", tmp_path)
    export(out, "csv", tmp_path, force=True)
    with pytest.raises(PipelineTrackerError, match="is there already"):
        export(out, "geojson", tmp_path, [ORIGIN], force=True)
    with pytest.raises(PipelineTrackerError, match="cannot be written"):
        export(out, "csv", tmp_path / "events.csv" / "x")


def test_a_new_replay_takes_old_exports_away(tmp_path: Path) -> None:
    place = replayed(tmp_path)
    export(place, "csv")
    export(place, "geojson", None, [ORIGIN])
    (place / "notes.csv").touch()
    settings = settings_from_values({"pipe.diameter": 0.6})
    replay(
        tmp_path / "bag",
        settings,
        place,
        force=True,
        stream=io.StringIO(),
        make_pipeline=StandIn,
    )
    assert {path.name for path in place.glob("*.csv")} == {"estimates.csv", "notes.csv"}
    assert not (place / "pipe.geojson").exists()


Capture = pytest.CaptureFixture[str]


def test_command(out: Path, tmp_path: Path, capsys: Capture) -> None:
    target = tmp_path / "a.geojson"
    command = ["export", str(out), "--format", "geojson", "--output", str(target)]
    assert run_command([*command, "--set", ORIGIN]) == 0
    said = capsys.readouterr().out
    assert said == (f"written: {target}: 7 points of the centreline, 3 stretches, 3 events\n")
    assert run_command([*command, "--set", ORIGIN, "--force"]) == 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["."], "no --format given; expected csv or geojson"),
        ([".", "--format", "kml"], "--format kml: expected one of csv, geojson"),
        ([".", "--format", "csv"], "no estimates.csv in it"),
    ],
)
def test_wrong_commands(
    arguments: list[str],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command(["export", *arguments]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_a_vehicle_that_turns_round_keeps_the_sense_of_chainage(tmp_path: Path) -> None:
    items = [i for i in SEA.items() if i.topic != "/vnm/pose"]
    for index in range(SEA.frames):
        yaw = 0.0 if index < 4 else math.pi
        pose = Pose.from_rpy([1.0 + 0.2 * min(index, 7 - index), 0.0, 0.0], [0.0, 0.0, yaw])
        items.append(pose_item("/vnm/pose", "pose", SEA.stamp(index), pose))
    items.sort(key=lambda item: item.log_ns + SECOND * (item.topic == "/vnm/pose") // 2)
    done = export(replayed(tmp_path, items), "csv")
    ahead = [round(r["chainage"] - r["vehicle_chainage"], 2) for r in done.tables.centreline]
    assert ahead == [1.25, 1.25, 1.25, -1.25, -1.25, -1.25, -1.25]
