"""Tables as GeoJSON (RFC 7946): WGS 84, positions as longitude, latitude, height."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from pipeline_tracker.export.tables import GEODETIC, Row, Tables

# 0.1 mm.
_DEGREES, _METRES = 9, 4


def feature_collection(tables: Tables) -> dict[str, Any]:
    """Return all that has a place, and the stretches.

    The property ``kind`` tells them apart: ``centreline`` (a line where the pipe was followed
    without a break), ``centreline_point``, ``stretch`` (a line where it was followed, else no
    geometry), ``event``.

    Args:
        tables: with latitude, longitude and height filled in.
    """
    points = tables.centreline
    lines = [_line_feature(list(rows)) for _, rows in groupby(points, _unbroken(points))]
    by_stretch = {n: list(rows) for n, rows in groupby(points, lambda row: row["stretch"])}
    features = [
        *(line for line in lines if line["geometry"]),
        *(
            _feature("stretch", row, _line(by_stretch.get(row["stretch"], [])))
            for row in tables.stretches
        ),
        *(_feature("centreline_point", row, _point(row)) for row in points),
        *(_feature("event", row, _point(row)) for row in tables.events),
    ]
    return {"type": "FeatureCollection", "features": features}


def _unbroken(points: list[Row]) -> Any:
    """Return a key that changes where frames are missing, or the tracker began anew."""
    keys, key = {}, 0
    before: Row | None = None
    for row in points:
        if before is not None:
            key += row["frame"] != before["frame"] + 1 or row["run"] != before["run"]
        keys[row["frame"]] = key
        before = row
    return lambda row: keys[row["frame"]]


def _line_feature(rows: list[Row]) -> dict[str, Any]:
    first, last = rows[0], rows[-1]
    properties = {
        "run": first["run"],
        "first_frame": first["frame"],
        "last_frame": last["frame"],
        "chainage_from": first["chainage"],
        "chainage_to": last["chainage"],
    }
    return _feature("centreline", properties, _line(rows))


def _feature(kind: str, row: Row, geometry: dict[str, Any] | None) -> dict[str, Any]:
    properties = {name: value for name, value in row.items() if name not in GEODETIC}
    return {"type": "Feature", "geometry": geometry, "properties": {"kind": kind, **properties}}


def _line(rows: Iterable[Row]) -> dict[str, Any] | None:
    positions = [_position(row) for row in rows]
    # A line has two positions or more.
    if len(positions) < 2:
        return None
    return {"type": "LineString", "coordinates": positions}


def _point(row: Row) -> dict[str, Any] | None:
    if row.get("latitude") is None:
        return None
    return {"type": "Point", "coordinates": _position(row)}


def _position(row: Row) -> list[float]:
    return [
        round(row["longitude"], _DEGREES),
        round(row["latitude"], _DEGREES),
        round(row["height"], _METRES),
    ]
