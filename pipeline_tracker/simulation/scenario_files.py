"""Scenarios from YAML files, and single values of them set by dotted names.

A file may begin where another scenario ends: ``extends: NAME``, the name of one that comes with the
package or the path of a file, relative to its own. Groups are merged key by key, lists replaced.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.resources import config_directory
from pipeline_tracker.settings_io import parse_yaml, shown
from pipeline_tracker.simulation.scenario import Scenario

_EXTENDS = "extends"


def list_scenarios() -> dict[str, str]:
    """Return the scenarios that come with the package: name and description, sorted by name.

    Raises:
        SettingsError: one of them cannot be read.
        ResourceError: the installation is not whole.
    """
    return {name: load_scenario(file).description for name, file in _files().items()}


def load_scenario(
    scenario: str | Path, overrides: Sequence[str] = (), seed: int | None = None
) -> Scenario:
    """Read a scenario: the model's defaults, what it extends, its file, the overrides, the seed.

    Args:
        scenario: name of a scenario that comes with the package, or path of a YAML file.
        overrides: ``key=value`` each, key dotted (``path.speed``, ``lamps.0.power``), value YAML.
        seed: wins over the file's and the overrides' seed.

    Raises:
        SettingsError: there is no such scenario, it is not YAML, or a key is unknown or its value
            impossible, or scenarios extend one another in a circle; the one line names key, value
            and what was expected.
    """
    # On top of the defaults, so that an override of one value keeps those beside it.
    merged = _defaults()
    for data in _layers(_find(scenario, Path())):
        merged = _merged(merged, data)
    for override in overrides:
        _set(merged, override)
    if seed is not None:
        merged["seed"] = seed
    return _validated(merged)


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario as YAML that ``load_scenario`` reads back to the same values."""
    return yaml.safe_dump(
        scenario.model_dump(mode="json"), sort_keys=False, default_flow_style=None
    )


def _defaults() -> dict[str, Any]:
    return Scenario().model_dump(mode="json")


def _files() -> dict[str, Path]:
    return {file.stem: file for file in sorted((config_directory() / "scenarios").glob("*.yaml"))}


def _layers(file: Path) -> list[dict[Any, Any]]:
    """Return what files say, that of the one extended last first, that of ``file`` last."""
    layers: list[dict[Any, Any]] = []
    seen: list[Path] = []
    while True:
        if file.resolve() in seen:
            circle = " -> ".join(f.stem for f in [*seen, file])
            raise SettingsError(f"extends goes in a circle ({circle}); take it out of {file}")
        seen.append(file.resolve())
        data = _content(file)
        base = data.pop(_EXTENDS, None)
        layers.insert(0, data)
        if base is None:
            return layers
        if not isinstance(base, str):
            raise SettingsError(f"{file}: extends={shown(base)}: expected the name of a scenario")
        file = _find(base, file.parent)


def _content(file: Path) -> dict[Any, Any]:
    try:
        raw = file.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"{file}: cannot be read ({error.strerror}); give a readable YAML file"
        ) from None
    data = parse_yaml(raw, f"{file}: ")
    if not isinstance(data, (dict, type(None))):
        raise SettingsError(f"{file}: holds {shown(data)}, expected keys and values of a scenario")
    return data or {}


def _find(scenario: str | Path, beside: Path) -> Path:
    files = _files()
    if str(scenario) in files:
        return files[str(scenario)]
    path = beside / scenario
    if path.is_file():
        return path
    raise SettingsError(
        f"scenario {shown(str(scenario))} is unknown; expected one of {', '.join(files)}, "
        "or the path of a YAML file"
    )


def _merged(defaults: Mapping[str, Any], data: Mapping[Any, Any]) -> dict[str, Any]:
    merged = dict(defaults)
    for key, value in data.items():
        below = defaults.get(key)
        both = isinstance(below, dict) and isinstance(value, dict)
        merged[str(key)] = _merged(below or {}, value) if both else value
    return merged


def _set(data: dict[str, Any], override: str) -> None:
    key, sign, text = override.partition("=")
    key = key.strip()
    if not sign or not key:
        raise SettingsError(f"--set {override}: expected key=value, for example --set frames=6")
    node: Any = data
    *parents, last = key.split(".")
    for name in parents:
        node = node[_place(node, name, override, key)]
        if not isinstance(node, (dict, list)):
            raise SettingsError(f"--set {override}: {name} is a single value; {_near(key)}")
    # Whether there is such a key is the model's to say.
    place = last if isinstance(node, dict) else _place(node, last, override, key)
    node[place] = parse_yaml(text.encode(), f"--set {override}: ")


def _place(node: Any, name: str, override: str, key: str) -> Any:
    """Return a key of a group or an index of a list, or refuse it."""
    if isinstance(node, dict):
        if name not in node:
            raise SettingsError(f"--set {override}: unknown key; {_near(key)}")
        return name
    if not (name.isdecimal() and int(name) < len(node)):
        raise SettingsError(
            f"--set {override}: {name!r} is not in the list, expected a number below {len(node)}"
        )
    return int(name)


def _validated(data: Mapping[str, Any]) -> Scenario:
    try:
        # As JSON: strict about numbers and text, but a list may stand for a vector.
        return Scenario.model_validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise SettingsError(_in_words(error.errors(include_url=False)[0])) from None
    except (TypeError, ValueError, RecursionError) as error:
        raise SettingsError(f"the scenario is not plain keys and values ({error})") from None


def _in_words(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"{key}={shown(error['input'])}: unknown key; {_near(key)}"
    message = str(error["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    message = message.replace("should be", "expected", 1)
    if not key:
        # A rule about several values says itself which.
        return message
    return f"{key}={shown(error['input'])}: {message}"


def _near(key: str) -> str:
    """Return a hint at the known key nearest to a wrong one."""
    known = list(_keys(_defaults(), ""))
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    if not near:
        # The last word alone, given without its group.
        near = [k for k in known if k.rsplit(".", 1)[-1] == key.rsplit(".", 1)[-1]][:1]
    return f"did you mean {near[0]}?" if near else "see the keys of config/scenarios/demo.yaml"


def _keys(values: Any, prefix: str) -> Iterator[str]:
    if isinstance(values, dict):
        for name, value in values.items():
            yield from _keys(value, f"{prefix}{name}.")
    elif isinstance(values, list) and any(isinstance(value, dict) for value in values):
        for index, value in enumerate(values):
            yield from _keys(value, f"{prefix}{index}.")
    else:
        yield prefix.removesuffix(".")
