"""Settings: what is taken, what is refused and in which words."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import (
    default_yaml,
    dotted_values,
    dump_settings,
    load_settings,
    replace_settings,
    settings_from_values,
)
from pipeline_tracker.settings_rows import SettingRow, describe_settings

DIAMETER = "pipe.diameter=0.6"
ROWS = {row.key: row for row in describe_settings()}


def refusal(*overrides: str, config: Path | None = None) -> str:
    with pytest.raises(SettingsError) as caught:
        load_settings(config, overrides)
    line = str(caught.value)
    assert "\n" not in line
    assert "pydantic" not in line
    return line


def write(folder: Path, text: str) -> Path:
    path = folder / "settings.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_defaults_with_only_the_diameter() -> None:
    settings = load_settings(overrides=[DIAMETER])
    assert settings.pipe.diameter == 0.6
    assert settings.radius == 0.3
    assert settings.motion.window == 1.0
    assert settings.camera.translation is None


def test_missing_diameter_says_how_to_give_it() -> None:
    line = refusal()
    assert "pipe.diameter is missing" in line
    assert "--set pipe.diameter=0.6" in line
    assert "--config" in line


@pytest.mark.parametrize(
    ("override", "shown"),
    [
        ("pipe.diameter=-1", "pipe.diameter=-1"),
        ("pipe.diameter=0", "pipe.diameter=0"),
        ("pipe.diameter=.nan", "pipe.diameter=nan"),
        ("pipe.diameter=.inf", "pipe.diameter=inf"),
        ("pipe.diameter='0.6'", "pipe.diameter='0.6'"),
        ("pipe.diameter=wide", "pipe.diameter='wide'"),
        ("pipe.diameter=true", "pipe.diameter=true"),
        ("pipe.diameter=", "pipe.diameter=(empty)"),
        ("pipe.diameter=[1]", "pipe.diameter=[1]"),
        ("pipe.diameter=11", "pipe.diameter=11"),
    ],
)
def test_bad_number_names_key_value_and_bound(override: str, shown: str) -> None:
    line = refusal(override)
    assert f"{shown}: expected a number, above 0, at most 10 (m)" in line


@pytest.mark.parametrize(
    "value", ["[0, 1]", "[0, .nan, 1]", "[0, 1, true]", "[0, 1, a]", "1", "{a: 1}", "[]"]
)
def test_bad_vector_is_refused(value: str) -> None:
    line = refusal(DIAMETER, f"camera.translation={value}")
    assert "camera.translation=" in line
    assert "expected a list of 3 finite numbers (m)" in line


@pytest.mark.parametrize("value", ["true", "2.0", "5", "'2'", "Auto"])
def test_bad_choice_lists_the_choices(value: str) -> None:
    line = refusal(DIAMETER, f"recognition.technique={value}")
    assert "expected one of auto, 1, 2, 3, 4" in line


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("sync.queue=3.0", "an integer, at least 1, at most 100"),
        ("sync.queue=0", "an integer, at least 1, at most 100"),
        ("use_sim_time=1", "true or false"),
        ("frames.base_link=''", "a text, not empty"),
        ("frames.base_link=3", "a text, not empty"),
    ],
)
def test_other_types_are_strict(override: str, expected: str) -> None:
    assert refusal(DIAMETER, override).endswith(f"expected {expected}")


@pytest.mark.parametrize(
    ("key", "near"),
    [
        ("pipe.diametre", "pipe.diameter"),
        ("diameter", "pipe.diameter"),
        ("camera.rotation", "camera.rotation_rpy"),
        ("motion.windows", "motion.window"),
        ("max_gap", "pose.max_gap"),
    ],
)
def test_unknown_key_names_the_closest(key: str, near: str) -> None:
    line = refusal(DIAMETER, f"{key}=1")
    assert line == f"--set {key}=1: unknown setting; did you mean {near}?"


def test_unknown_key_far_from_all_points_to_the_list() -> None:
    assert "config/default.yaml" in refusal(DIAMETER, "zzz=1")


@pytest.mark.parametrize("text", ["pipe.diameter", "=3", ""])
def test_override_without_key_or_value(text: str) -> None:
    assert "expected key=value" in refusal(text)


def test_group_is_no_value() -> None:
    assert "group of settings" in refusal("pipe=0.6")


def test_override_that_is_no_yaml() -> None:
    assert "not valid YAML" in refusal("pipe.diameter=[0.6")


def test_integer_for_number_list_for_vector_and_exponents() -> None:
    settings = load_settings(
        overrides=[
            "pipe.diameter=1",
            "camera.translation=[0, 1, 2.5]",
            "sync.tolerance=1e-3",
            "recognition.technique=2",
        ]
    )
    assert settings.pipe.diameter == 1.0
    assert settings.camera.translation == (0.0, 1.0, 2.5)
    assert settings.sync.tolerance == 0.001
    assert settings.recognition.technique == 2


@pytest.mark.parametrize(
    "text",
    [
        "pipe: {diameter: 0.5}\nsync: {queue: 3}\n",
        "pipe.diameter: 0.5\nsync.queue: 3\n",
        "pipe: {diameter: 0.5}\nsync.queue: 3\ncamera:\n",
        "/**:\n  ros__parameters:\n    pipe: {diameter: 0.5}\n    sync.queue: 3\n",
        "/a: {ros__parameters: {pipe.diameter: 0.5}}\n/b: {ros__parameters: {sync: {queue: 3}}}\n",
        "/**: {ros__parameters: {pipe.diameter: 0.5, sync.queue: 3, qos_overrides: {t: {d: 5}}}}\n",
    ],
)
def test_file_forms(tmp_path: Path, text: str) -> None:
    settings = load_settings(write(tmp_path, text))
    assert (settings.pipe.diameter, settings.sync.queue) == (0.5, 3)


def test_later_sources_win(tmp_path: Path) -> None:
    path = write(tmp_path, "pipe.diameter: 0.5\nsync.queue: 3\n")
    base = {"pipe.diameter": 0.1, "sync.queue": 1, "segment.length": 1.0}
    settings = load_settings(path, ["sync.queue=5"], base)
    assert settings.pipe.diameter == 0.5
    assert settings.sync.queue == 5
    assert settings.segment.length == 1.0


def test_error_in_a_file_names_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "pipe:\n  diameter: -0.5\n")
    assert refusal(config=path).startswith(f"{path}: pipe.diameter=-0.5: expected a number")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[1, 2]", "expected keys and values"),
        ("a: b: c", "not valid YAML in line 1, column 5"),
        ("a: &a {b: *a}", "unknown setting"),
        ("a: &a [*a]", "unknown setting"),
        ("1: 2", "unknown setting"),
        ("pipe: 3", "group of settings"),
        ("camera: [1, 2]", "camera.translation"),
        ("[" * 5000, "not valid YAML"),
        ("pipe.diameter: 2024-13-45", "not valid YAML"),
        ("? [1, 2]\n: 3", "not valid YAML"),
        ("pipe.diameter: !!python/object/apply:os.getcwd []", "not valid YAML"),
        ("pipe.diameter: 1\npipe: {diameter: 2}", "pipe.diameter is given twice"),
        (
            "pipe: {diameter: 1, diameter: 2}",
            "not valid YAML in line 1, column 7 (diameter is given",
        ),
        ("", "pipe.diameter is missing"),
        ("pipe:\n", "pipe.diameter is missing"),
    ],
)
def test_bad_file(tmp_path: Path, text: str, expected: str) -> None:
    assert expected in refusal(config=write(tmp_path, text))


def test_document_that_repeats_itself_stays_one_short_line(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    assert len(refusal(config=write(tmp_path, "\n".join(lines)))) < 300


def test_missing_unreadable_and_binary_files(tmp_path: Path) -> None:
    assert "no such settings file" in refusal(config=tmp_path / "none.yaml")
    assert "cannot be read" in refusal(config=tmp_path)
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\x00\x01\xff\xfe")
    assert "not valid YAML" in refusal(config=path)
    path.write_bytes(b"# " + b"x" * 1_100_000)
    assert "larger than" in refusal(config=path)


def test_dumped_settings_come_back(tmp_path: Path) -> None:
    settings = load_settings(
        overrides=[
            "pipe.diameter=0.1234567890123456",
            "camera.translation=[0.1, 1e-9, -3]",
            "recognition.technique=4",
            "topics.left_image=/cam0/image",
        ]
    )
    path = write(tmp_path, dump_settings(settings, "written by a test\nwith two lines"))
    assert load_settings(path) == settings


@given(
    st.floats(min_value=1e-300, max_value=10, exclude_min=True),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3),
)
def test_any_number_survives_a_dump(diameter: float, vector: list[float]) -> None:
    settings = settings_from_values({"pipe.diameter": diameter, "camera.rotation_rpy": vector})
    text = dump_settings(settings)
    loaded = yaml.safe_load(text)
    assert loaded["pipe"]["diameter"] == diameter
    assert loaded["camera"]["rotation_rpy"] == vector


def test_replaced_settings_are_checked() -> None:
    settings = load_settings(overrides=[DIAMETER])
    changed = replace_settings(settings, {"mode": "mono", "camera.translation": [1, 2, 3]})
    assert changed.mode == "mono"
    assert changed.camera.translation == (1.0, 2.0, 3.0)
    assert settings.mode == "stereo"
    with pytest.raises(SettingsError, match="expected one of stereo, mono"):
        replace_settings(settings, {"mode": "trio"})


def test_default_yaml_is_up_to_date() -> None:
    path = Path(__file__).parents[1] / "config" / "default.yaml"
    assert path.read_text(encoding="utf-8") == default_yaml(), (
        "run: python -m pipeline_tracker.settings_io > config/default.yaml"
    )


def test_default_yaml_is_complete_and_loads(tmp_path: Path) -> None:
    text = default_yaml()
    settings = load_settings(write(tmp_path, text), [DIAMETER])
    assert settings == load_settings(overrides=[DIAMETER])
    # With the '#' before each key removed, it gives every setting there is.
    full = "\n".join(
        line.replace("# ", "", 1) if any(f"# {key}:" in line for key in ROWS) else line
        for line in text.splitlines()
    )
    assert set(yaml.safe_load(full)["/**"]["ros__parameters"]) == set(ROWS)
    load_settings(write(tmp_path, full))


def test_rows_describe_every_setting() -> None:
    settings = load_settings(overrides=[DIAMETER])
    assert set(dotted_values(settings)) == set(ROWS)
    for row in ROWS.values():
        assert row.description
        assert row.type
    assert ROWS["pipe.diameter"] == SettingRow(
        key="pipe.diameter",
        kind="number",
        default=None,
        required=True,
        optional=False,
        minimum=None,
        maximum=10,
        above=0,
        choices=(),
        unit="m",
        description=ROWS["pipe.diameter"].description,
    )
    assert ROWS["camera.translation"].optional
    assert ROWS["mode"].choices == ("stereo", "mono")
    assert ROWS["sync.queue"].range == "at least 1, at most 100"


def _outside(row: SettingRow) -> list[Any]:
    values: list[Any] = []
    if row.kind == "number":
        values += [math.nan, math.inf, -math.inf, "1", True]
    if row.kind in ("number", "integer"):
        step = 1 if row.kind == "integer" else 1e-6
        values += [row.above] if row.above is not None else []
        values += [row.minimum - step] if row.minimum is not None else []
        values += [row.maximum + step] if row.maximum is not None else []
    if row.kind == "integer":
        values += [1.5, "1", True]
    if row.kind in ("text", "boolean"):
        values += [3, 1.5]
    if row.kind == "vector":
        values += [[1, 2], [math.nan] * 3, "xyz"]
    return values or ["no such choice"]


@pytest.mark.parametrize("key", sorted(ROWS))
def test_every_setting_refuses_what_is_outside(key: str) -> None:
    for value in _outside(ROWS[key]):
        with pytest.raises(SettingsError) as caught:
            settings_from_values({"pipe.diameter": 0.6, key: value})
        assert str(caught.value).startswith(f"{key}=")
        assert "expected" in str(caught.value)


def test_settings_never_change() -> None:
    settings = load_settings(overrides=[DIAMETER])
    assert isinstance(settings, Settings)
    with pytest.raises(Exception, match="frozen"):
        settings.mode = "mono"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (f"pipe.diameter: {'[' * 5000}", "more than 50 brackets within brackets"),
        ("\n".join(f"k{i}: 0" for i in range(2001)), "more than 2000 values"),
        (f"frames.odom: {'x' * 100_000}", "larger than 100000 bytes"),
        (
            "g0: &g0 {x: 1}\n"
            + "\n".join(
                f"g{i}: &g{i} {{{', '.join(f'k{j}: *g{i - 1}' for j in range(9))}}}"
                for i in range(1, 9)
            ),
            "more than 2000 values",
        ),
    ],
)
def test_a_file_that_would_take_for_ever_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=reason):
        load_settings(file)
