"""What `export` does: read a replay, place it, write the files."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline_tracker.export.errors import ExportError
from pipeline_tracker.export.geodesy import Georeference
from pipeline_tracker.export.geojson import feature_collection
from pipeline_tracker.export.tables import COLUMNS, GEODETIC, PLACE, Row, Tables, make_tables
from pipeline_tracker.report.reasons import count
from pipeline_tracker.report.record import read_record
from pipeline_tracker.settings import ExportSettings
from pipeline_tracker.settings_io import load_settings

FORMATS = ("csv", "geojson")
GEOJSON_FILE = "pipe.geojson"
# Names of the files that are written where no other is given.
FILES = (*(f"{name}.csv" for name in COLUMNS), GEOJSON_FILE)


@dataclass(frozen=True)
class ExportOutcome:
    """What was exported.

    Attributes:
        files: what was written.
        tables: what is in them.
    """

    files: tuple[Path, ...]
    tables: Tables

    def in_words(self) -> str:
        """Return it for a person."""
        tables = self.tables
        return (
            f"written: {', '.join(map(str, self.files))}: "
            f"{count(len(tables.centreline), 'point')} of the centreline, "
            f"{count(len(tables.stretches), 'stretch', 'es')}, {count(len(tables.events), 'event')}"
        )


def export(
    directory: Path,
    form: str,
    output: Path | None = None,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
) -> ExportOutcome:
    """Write the results of a replay for other programs.

    Args:
        directory: the output of a replay.
        form: one of ``FORMATS``.
        output: GeoJSON: a file; CSV: a directory, for three files; by default in ``directory``.
        overrides: ``key=value`` each, beside the replay's own settings.
        force: whether files that are there may be replaced.

    Raises:
        PipelineTrackerError: bad input, no place on the earth for GeoJSON, or nothing to place.
    """
    if form not in FORMATS:
        raise ExportError(f"--format {form}: expected one of {', '.join(FORMATS)}")
    record = read_record(directory)
    if not record.rows:
        raise ExportError(f"{directory}: estimates.csv has no rows, there is nothing to export")
    settings = load_settings(directory / "settings.yaml", list(overrides)).export
    tables = make_tables(record)
    if form == "geojson":
        _check_place(directory, tables, settings)
    if settings.origin is not None:
        reference = Georeference(settings)
        _add_places(tables.centreline, reference)
        _add_places(tables.events, reference)
    try:
        if form == "geojson":
            files = _write_geojson(output or directory / GEOJSON_FILE, tables, force=force)
        else:
            files = _write_csv(output or directory, tables, force=force)
    except OSError as error:
        raise ExportError(
            f"{output or directory}: cannot be written ({error.strerror or error}); name another "
            "place with --output"
        ) from None
    return ExportOutcome(files, tables)


def _check_place(directory: Path, tables: Tables, settings: ExportSettings) -> None:
    if settings.origin is None:
        raise ExportError(
            "GeoJSON needs odom's place on the earth; give latitude, longitude and height of its "
            "origin with --set export.origin=[LAT,LON,HEIGHT], and where its x axis is not east "
            "--set export.yaw=RAD; or use --format csv"
        )
    if not tables.centreline:
        raise ExportError(
            f"{directory}: no frame has both a pipe and a pose, there is nothing to place on a "
            "map; use --format csv"
        )


def _add_places(rows: list[Row], reference: Georeference) -> None:
    known = [row for row in rows if row.get("x") is not None]
    if not known:
        return
    points = np.array([[row[axis] for axis in PLACE] for row in known])
    for row, place in zip(known, reference.place(points), strict=True):
        row.update(zip(GEODETIC, map(float, place), strict=True))


def _write_geojson(path: Path, tables: Tables, *, force: bool) -> tuple[Path, ...]:
    _check_free(path, force=force)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(feature_collection(tables), allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8")
    return (path,)


def _write_csv(directory: Path, tables: Tables, *, force: bool) -> tuple[Path, ...]:
    paths = {name: directory / f"{name}.csv" for name in COLUMNS}
    for path in paths.values():
        _check_free(path, force=force)
    directory.mkdir(parents=True, exist_ok=True)
    for name, path in paths.items():
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS[name])
            rows: list[Row] = getattr(tables, name)
            writer.writerows([_cell(c, row.get(c)) for c in COLUMNS[name]] for row in rows)
    return tuple(paths.values())


def _check_free(path: Path, *, force: bool) -> None:
    if path.exists() and not (force and path.is_file()):
        raise ExportError(f"{path}: is there already; name another, or replace it with --force")


def _cell(column: str, value: Any) -> str:
    if value is None:
        return ""
    if not isinstance(value, float):
        return str(value)
    # 0.1 mm of a latitude, 1 um of all else.
    return f"{value:.9f}" if column in ("latitude", "longitude") else f"{value:.6f}"
