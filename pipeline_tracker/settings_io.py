"""Settings from a YAML file and ``--set``, and the settings model put into words.

A file holds nested or dotted keys, or is a ROS parameter file (``/**: ros__parameters: ...``).
"""

from __future__ import annotations

import difflib
import math
import re
import reprlib
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_rows import SettingRow, describe_settings

# Far more than anybody writes, and little enough to be read in seconds, whatever it is.
_MAX_FILE_BYTES = 100_000
_MAX_VALUES = 2000
_MAX_BRACKETS = 50


class _Loader(yaml.SafeLoader):
    """Safe YAML that takes 1e-3 for a number, as YAML 1.2 does, and no key twice."""

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:  # noqa: N803 - PyYAML's name
        if self.flow_level >= _MAX_BRACKETS:
            raise yaml.scanner.ScannerError(
                None, None, f"more than {_MAX_BRACKETS} brackets within brackets", self.get_mark()
            )
        super().fetch_flow_collection_start(TokenClass)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in keys:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key.value} is given twice", node.start_mark
                )
            keys.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


# Values are shown short, and a document that repeats itself a million times stays so too.
_short = reprlib.Repr()
_short.maxlevel, _short.maxstring, _short.maxother = 2, 60, 60


def load_settings(
    config: Path | None = None,
    overrides: Sequence[str] = (),
    base: Mapping[str, Any] | None = None,
) -> Settings:
    """Load settings: defaults, then ``base``, then the file, then ``--set``.

    Args:
        config: YAML file, or None.
        overrides: ``key=value`` each, the value read as YAML.
        base: dotted keys and values that file and overrides win over.

    Raises:
        SettingsError: the file cannot be read, or a setting is unknown, missing or out of range;
            its one line names key, value, what was expected and what to do.
    """
    values: dict[str, Any] = {}
    origins: dict[str, str] = {}

    def take(given: Mapping[str, Any], origin: str) -> None:
        values.update(given)
        origins.update(dict.fromkeys(given, origin))

    take(dict(base or {}), "")
    if config is not None:
        take(_read_file(config), str(config))
    for override in overrides:
        take(_read_override(override), "--set")
    return settings_from_values(values, origins)


def settings_from_values(
    values: Mapping[str, Any], origins: Mapping[str, str] | None = None
) -> Settings:
    """Build settings from dotted keys and values, as ROS parameters give them.

    Args:
        values: values by dotted key; lists are taken for vectors, integers for numbers.
        origins: where each key came from, for the error's text.

    Raises:
        SettingsError: a setting is unknown, missing or out of its range.
    """
    rows = {row.key: row for row in describe_settings()}
    nested: dict[str, Any] = {}
    for key, value in values.items():
        origin = (origins or {}).get(key, "")
        if key not in rows:
            raise SettingsError(_at(origin) + _unknown(key, value, rows))
        if not _is_choice(rows[key], value):
            raise SettingsError(_refused(rows[key], value, origin))
        taken = tuple(value) if isinstance(value, list) else value
        target = nested
        *groups, name = key.split(".")
        for group in groups:
            target = target.setdefault(group, {})
        target[name] = taken
    if "pipe" not in nested:
        nested["pipe"] = {}
    try:
        return Settings.model_validate(nested)
    except ValidationError as error:
        first = error.errors()[0]
        raise SettingsError(_in_words(first, rows, values, origins or {})) from None


def dotted_values(settings: Settings) -> dict[str, Any]:
    """Return all settings by dotted key; vectors as lists, settings left empty as None."""
    values: dict[str, Any] = {}
    for row in describe_settings():
        value: Any = settings
        for name in row.key.split("."):
            value = getattr(value, name)
        values[row.key] = list(value) if isinstance(value, tuple) else value
    return values


def replace_settings(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with some dotted keys changed, checked as those of a user.

    Raises:
        SettingsError: see ``settings_from_values``.
    """
    values = {k: v for k, v in dotted_values(settings).items() if v is not None}
    return settings_from_values({**values, **changes})


def dump_settings(settings: Settings, comment: str = "") -> str:
    """Write settings as YAML that ``load_settings`` reads back to the same values."""
    nested: dict[str, Any] = {}
    for key, value in dotted_values(settings).items():
        if value is None:
            continue
        *groups, name = key.split(".")
        target = nested
        for group in groups:
            target = target.setdefault(group, {})
        target[name] = value
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + yaml.safe_dump(nested, sort_keys=False, default_flow_style=None)


def default_yaml() -> str:
    """Return config/default.yaml: every setting with its default, unit and range.

    It is a ROS parameter file; ``--config`` takes it as well.
    """
    lines = [
        "# All settings of pipeline_tracker with their defaults, units and ranges.",
        "# A line that begins with '# key:' has no default: remove the '#' and give a value.",
        "# Use it with `pipeline-tracker run --config FILE` (or replay), or as a ROS parameter",
        "# file. Written by: python -m pipeline_tracker.settings_io > config/default.yaml",
        "/**:",
        "  ros__parameters:",
    ]
    example = {
        "pipe.diameter": 0.6,
        "camera.translation": [0.0, 0.0, 0.0],
        "camera.rotation_rpy": [3.1416, 0.0, -1.5708],
        "export.origin": [43.1, 131.9, 0.0],
    }
    for row in describe_settings():
        live = f"at run time: {', '.join(row.live)}" if row.live else ""
        words = "; ".join(filter(None, (row.unit, row.range, live)))
        comment = row.description + (f" [{words}]" if words else "")
        lines += textwrap.wrap(comment, 96, initial_indent="    # ", subsequent_indent="    # ")
        value = example[row.key] if row.default is None else row.default
        mark = "# " if row.default is None else ""
        text = yaml.safe_dump(value, default_flow_style=True).split("\n")[0]
        lines.append(f"    {mark}{row.key}: {text}")
    return "\n".join(lines) + "\n"


def settings_table() -> str:
    """Return the README's table of all settings (Markdown); * marks what may change live."""
    lines = ["| setting | default | range, unit | meaning |", "|---|---|---|---|"]
    for row in describe_settings():
        if row.required:
            default = "must be given"
        elif row.default is None:
            default = "from /tf_static" if row.key.startswith("camera.") else "none"
        else:
            value = yaml.safe_dump(row.default, default_flow_style=True).split("\n")[0]
            default = f"`{value}`" if value != "''" else "empty"
        words = ", ".join(filter(None, (row.range, row.unit)))
        mark = " *" if row.live else ""
        lines.append(f"| `{row.key}`{mark} | {default} | {words} | {row.description} |")
    return "\n".join(lines) + "\n"


def _read_file(path: Path) -> dict[str, Any]:
    return {key: value for key, value, is_qos in _values_of(path) if not is_qos}


def read_qos_overrides(path: Path) -> dict[str, Any]:
    """Return ROS's QoS override parameters of a ROS parameter file, by dotted key.

    Raises:
        SettingsError: the file cannot be read, or one of them is no parameter.
    """
    found = {key: value for key, value, is_qos in _values_of(path) if is_qos}
    for key, value in found.items():
        if not isinstance(value, str | bool | int | float):
            raise SettingsError(f"{path}: {key}={shown(value)}: expected a name or a number")
    return found


def _values_of(path: Path) -> Iterator[tuple[str, Any, bool]]:
    """Yield the keys and values of a file, and whether they are ROS's QoS overrides."""
    document = parse_yaml(_read_bytes(path), f"{path}: ")
    if document is None:
        return
    if not isinstance(document, dict):
        raise SettingsError(
            f"{path}: holds {shown(document)}, expected keys and values like `pipe.diameter: 0.6`"
        )
    taken: set[str] = set()
    for part, is_ros in _parts(document):
        for key, value in _flatten(part, "", str(path)):
            # References to references grow without end in a small file.
            if len(taken) >= _MAX_VALUES:
                raise SettingsError(
                    f"{path}: more than {_MAX_VALUES} values, expected a YAML file of settings"
                )
            if key in taken:
                raise SettingsError(f"{path}: {key} is given twice; leave one of them")
            taken.add(key)
            yield key, value, is_ros and key.startswith("qos_overrides.")


def _read_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            raw = stream.read(_MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise SettingsError(f"{path}: no such settings file; give an existing YAML file") from None
    except OSError as error:
        raise SettingsError(
            f"{path}: cannot be read ({error.strerror}); give a readable YAML file"
        ) from None
    if len(raw) > _MAX_FILE_BYTES:
        raise SettingsError(
            f"{path}: larger than {_MAX_FILE_BYTES} bytes, expected a YAML file of settings"
        )
    return raw


def _parts(document: Mapping[Any, Any]) -> Iterator[tuple[Mapping[Any, Any], bool]]:
    """Yield the parameters of a ROS parameter file, or else the document itself."""
    plain: dict[Any, Any] = {}
    for key, value in document.items():
        if isinstance(value, dict) and set(value) == {"ros__parameters"}:
            yield value["ros__parameters"] or {}, True
        else:
            plain[key] = value
    if plain:
        yield plain, False


@lru_cache(maxsize=1)
def _known_keys() -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of all settings, and of their groups."""
    known = frozenset(row.key for row in describe_settings())
    return known, frozenset(key.rpartition(".")[0] for key in known) - {""}


def _flatten(values: Any, prefix: str, origin: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(values, dict):
        raise SettingsError(
            f"{_at(origin)}{prefix}={shown(values)}: this is a group of settings, "
            f"expected keys and values below it ({_group_keys(prefix)})"
        )
    known, groups = _known_keys()
    for name, value in values.items():
        key = f"{prefix}.{name}" if prefix else str(name)
        is_group = key in groups
        if is_group and value is None:
            continue
        # The bound on the depth is for documents that contain themselves.
        deeper = isinstance(value, dict) and key not in known and key.count(".") < 8
        if is_group or (deeper and value):
            yield from _flatten(value, key, origin)
        else:
            yield key, value


def _read_override(text: str) -> dict[str, Any]:
    key, sign, value = text.partition("=")
    key = key.strip()
    if not sign or not key:
        raise SettingsError(
            f"--set {text}: expected key=value, for example --set pipe.diameter=0.6"
        )
    return dict(_flatten({key: parse_yaml(value.encode(), f"--set {text}: ")}, "", "--set"))


def parse_yaml(raw: bytes, origin: str) -> Any:
    """Parse YAML from a user.

    Args:
        raw: the text.
        origin: what to begin an error's line with.

    Raises:
        SettingsError: it is not YAML.
    """
    try:
        # A subclass of SafeLoader, as safe as that.
        return yaml.load(raw, _Loader)  # noqa: S506
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f" in line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise SettingsError(f"{origin}not valid YAML{place} ({error.problem})") from None
    except (yaml.YAMLError, ValueError, RecursionError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SettingsError(f"{origin}not valid YAML ({reason})") from None


def _in_words(
    error: Any,
    rows: Mapping[str, SettingRow],
    values: Mapping[str, Any],
    origins: Mapping[str, str],
) -> str:
    # The location of an item of a vector ends with its index.
    location = [str(part) for part in error["loc"]]
    key = next(
        (k for n in range(len(location), 0, -1) if (k := ".".join(location[:n])) in rows),
        ".".join(location),
    )
    if key not in rows:
        return f"{key}: {error['msg']}"
    row = rows[key]
    if key not in values:
        return (
            f"{key} is missing, expected {row.expected}; give it with --set {key}=0.6, "
            f"or as `{key}: 0.6` in the file of --config"
        )
    return _refused(row, values[key], origins.get(key, ""))


def _refused(row: SettingRow, value: Any, origin: str) -> str:
    return f"{_at(origin)}{row.key}={shown(value)}: expected {row.expected}"


def _is_choice(row: SettingRow, value: Any) -> bool:
    """Tell whether a value is one of the choices: in Python True equals 1, and 2.0 equals 2."""
    return row.kind != "choice" or any(type(value) is type(c) and value == c for c in row.choices)


def _unknown(key: str, value: Any, rows: Mapping[str, SettingRow]) -> str:
    near = difflib.get_close_matches(key, rows, n=1, cutoff=0.5)
    if not near:
        # The last word alone, given without its group.
        near = [k for k in rows if k.rsplit(".", 1)[-1] == key.rsplit(".", 1)[-1]][:1]
    hint = f"did you mean {near[0]}?" if near else "all settings are listed in config/default.yaml"
    return f"{key}={shown(value)}: unknown setting; {hint}"


def _group_keys(group: str) -> str:
    keys = [row.key for row in describe_settings() if row.key.startswith(f"{group}.")]
    return ", ".join(keys[:6]) if keys else "see config/default.yaml"


def _at(origin: str) -> str:
    return f"{origin}: " if origin and origin != "--set" else f"{origin} ".lstrip()


def shown(value: Any) -> str:
    """Return a user's value as an error shows it: short, and as YAML writes it."""
    if value is None:
        return "(empty)"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return _short.repr(value)


if __name__ == "__main__":
    sys.stdout.write(settings_table() if "table" in sys.argv[1:] else default_yaml())
