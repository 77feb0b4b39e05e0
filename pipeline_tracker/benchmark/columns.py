"""The columns of a benchmark's table: one list for the terminal, CSV, JSON, HTML and the docs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pipeline_tracker.benchmark.lines import Line

Value = str | int | float | None

_DEGREES = math.degrees(1.0)


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes:
        key: its name in CSV and JSON; ends with the unit.
        title: its name for a person, within its group.
        group: which columns it stands with.
        description: what it is.
        of: its value in a line.
        unit: of the value.
        decimals: as it is shown to a person; None for text and counts.
    """

    key: str
    title: str
    group: str
    description: str
    of: Callable[[Line], Value]
    unit: str = ""
    decimals: int | None = None

    def shown(self, line: Line) -> str:
        """Return the value as a person reads it."""
        value = self.of(line)
        if value is None:
            return "-"
        return f"{value:.{self.decimals}f}" if self.decimals is not None else str(value)


def all_columns() -> list[Column]:
    """Return all columns in their order."""
    return [*_identity(), *_found(), *_divergence(), *_errors(), *_time(), *_geometry()]


def _identity() -> list[Column]:
    group = "run"
    return [
        Column("name", "name", group, "Scenario or bag, or the name given to it", lambda x: x.name),
        Column("seed", "seed", group, "Seed of the sea; how many in a pooled line", _seed),
        Column("variant", "variant", group, "Name of the settings", lambda x: x.variant),
        Column(
            "state",
            "state",
            group,
            "done; failed; not done (interrupted before it); pooled: all frames of the done runs "
            "of a scenario and variant together",
            lambda x: x.state,
        ),
        Column("reason", "reason", group, "Why it failed", lambda x: x.reason or None),
    ]


def _seed(line: Line) -> Value:
    return line.seed or None


def _count(name: str) -> Callable[[Line], Value]:
    return lambda line: line.figures.counts.get(name)


def _share(part: str, of: str) -> Callable[[Line], Value]:
    def value(line: Line) -> Value:
        share = line.figures.share(part, of)
        return None if share is None else 100.0 * share

    return value


def _stat(name: str, which: str, scale: float = 1.0) -> Callable[[Line], Value]:
    def value(line: Line) -> Value:
        stat = line.figures.stats.get(name)
        number: float | None = getattr(stat, which) if stat is not None else None
        return None if number is None else scale * number

    return value


def _frames(name: str) -> Callable[[Line], Value]:
    def value(line: Line) -> Value:
        stat = line.figures.stats.get(name)
        if stat is None:
            return 0 if line.figures.counts else None
        return stat.n

    return value


def _reasons(line: Line) -> Value:
    reasons = line.figures.reasons
    return ", ".join(f"{name} {n}" for name, n in reasons.items()) or None


def _found() -> list[Column]:
    group = "found"
    return [
        Column("frames", "frames", group, "Left images", _count("frames")),
        Column(
            "valid_percent",
            "valid",
            group,
            "Share of all frames that are valid",
            _share("valid", "frames"),
            "%",
            1,
        ),
        Column(
            "detectable",
            "detect-able",
            group,
            "Frames in whose left image a quarter of one contour's length in view is not hidden",
            _count("detectable"),
        ),
        Column(
            "detectable_valid_percent",
            "of these valid",
            group,
            "Share of the detectable frames that are valid",
            _share("detectable_valid", "detectable"),
            "%",
            1,
        ),
        Column(
            "false_valid",
            "false valid",
            group,
            "Valid frames with no pipe in view, an end off by more than 5 cm (10 cm beyond 3 m of "
            "distance), or the direction by more than 3 degrees",
            _count("false_valid"),
        ),
        *_searches(),
        Column(
            "false_valid_reasons",
            "why false",
            group,
            "no_pipe_in_view, end, direction; a frame may have several",
            _reasons,
        ),
    ]


def _searches() -> list[Column]:
    columns = []
    for name, title, words in (
        ("find", "to find", "before the pipe was ever found"),
        ("find_again", "to find again", "after it was lost or came into sight again"),
    ):
        columns += [
            Column(
                f"frames_to_{name}",
                title,
                "found",
                f"Mean length of the searches {words}, frames; 0: the first frame finds it",
                _stat(f"to_{name}", "mean"),
                "frames",
                1,
            ),
            Column(
                f"{name}_failed",
                "never",
                "found",
                f"Searches {words} that did not find it while it was there",
                _count(f"never_{name.replace('find', 'found')}"),
            ),
        ]
    return columns


def _divergence() -> list[Column]:
    columns = []
    for prefix, group, frames in (
        ("", "divergence", "valid frames"),
        ("tracking_", "tracking", "valid frames by tracking"),
        ("recognition_", "recognition", "valid frames by recognition"),
    ):
        columns.append(
            Column(
                f"{prefix}measured",
                "n",
                group,
                f"Number of {frames} measured against the true axis",
                _frames(f"{prefix}horizontal"),
            )
        )
        for part, letter in (("horizontal", "h"), ("vertical", "v")):
            for which, word, name in (("mean", "mean", "mean"), ("extreme", "max", "greatest")):
                columns.append(
                    Column(
                        f"{prefix}{part}_{word}_cm",
                        f"{letter} {word}",
                        group,
                        f"The paper's measure over {frames}: sum over the segment's ends of the "
                        f"{part} distance from the true axis, {name}",
                        _stat(f"{prefix}{part}", which, 100.0),
                        "cm",
                        2,
                    )
                )
    return columns


def _errors() -> list[Column]:
    columns = []
    for name, short, words, unit, key, scale in (
        ("heading_misalignment", "heading", "heading misalignment", "°", "deg", _DEGREES),
        ("pitch_misalignment", "pitch", "pitch misalignment", "°", "deg", _DEGREES),
        ("min_distance", "distance", "least distance from the left camera", "cm", "cm", 100.0),
        ("lateral_offset", "lateral", "lateral offset", "cm", "cm", 100.0),
        ("approach_speed", "speed", "approach speed", "cm/s", "cm_per_s", 100.0),
    ):
        for which, meaning in (("mean", "with sign"), ("rms", "root of the mean square")):
            columns.append(
                Column(
                    f"{short}_{which}_{key}",
                    f"{short} {which}",
                    "errors",
                    f"Error of the {words}, estimate less truth, over valid frames: {meaning}",
                    _stat(name, which, scale),
                    unit,
                    2,
                )
            )
    columns.append(
        Column(
            "coverage_95_percent",
            "in 95 %",
            "errors",
            "Share of valid frames whose 95 % region holds the true axis",
            _stat("covered", "mean", 100.0),
            "%",
            1,
        )
    )
    for which, word, name in (("mean", "mean", "mean"), ("extreme", "max", "greatest")):
        columns.append(
            Column(
                f"contours_{word}_px",
                f"contours {word}",
                "errors",
                "Distance of the published contour lines from the true contours in the images, "
                f"of valid frames: {name} over lines",
                _stat("contours", which),
                "px",
                2,
            )
        )
    return columns


def _time() -> list[Column]:
    group = "time"
    return [
        Column(
            "simulate_s",
            "simulate",
            group,
            "Time to simulate the sea, whenever that was; variants share it",
            lambda x: x.seconds_simulate,
            "s",
            1,
        ),
        Column(
            "replay_s", "replay", group, "Time of the replay", lambda x: x.seconds_replay, "s", 1
        ),
        Column(
            "median_ms",
            "median",
            group,
            "Median time of a frame; of a pooled line the median of its runs'",
            lambda x: x.median_ms,
            "ms",
            0,
        ),
    ]


def _geometry() -> list[Column]:
    group = "geometry"
    return [
        Column("camera", "camera", group, "Image size, px", _camera, "px"),
        Column(
            "field_of_view_deg",
            "field of view",
            group,
            "Horizontal field of view",
            lambda x: x.geometry.field_of_view,
            "°",
            1,
        ),
        Column(
            "baseline_m",
            "base-line",
            group,
            "Between the cameras; none with one camera",
            lambda x: x.geometry.baseline,
            "m",
            3,
        ),
        Column(
            "mounting",
            "mounting",
            group,
            "Left optical frame in base_link: x y z, m; roll pitch yaw, degrees",
            _mounting,
        ),
        Column("lamps", "lamps", group, "Places of the lamps in base_link, m", _lamps),
        Column(
            "distance_m",
            "distance",
            group,
            "Nominal height of the left camera above the pipe's top",
            lambda x: x.geometry.distance,
            "m",
            2,
        ),
        Column(
            "diameter_m",
            "diameter",
            group,
            "Outer diameter of the true pipe",
            lambda x: x.geometry.diameter,
            "m",
            3,
        ),
    ]


def _camera(line: Line) -> Value:
    size = line.geometry.width, line.geometry.height
    return None if None in size else f"{size[0]} x {size[1]}"


def _mounting(line: Line) -> Value:
    place, angles = line.geometry.translation, line.geometry.rotation
    if place is None or angles is None:
        return None
    return f"{_numbers(place)}; {_numbers(angles)}"


def _lamps(line: Line) -> Value:
    lamps = line.geometry.lamps
    return None if lamps is None else "; ".join(_numbers(lamp) for lamp in lamps)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
