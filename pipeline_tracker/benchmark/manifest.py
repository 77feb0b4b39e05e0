"""The manifest of a benchmark: which scenarios or bags, which seeds, which settings.

A manifest says what is to be measured; ``plan`` makes single tasks of it.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pipeline_tracker.errors import ManifestError, SettingsError
from pipeline_tracker.resources import config_directory
from pipeline_tracker.settings_io import parse_yaml, shown

_MAX_FILE_BYTES = 1_000_000
_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"

Name = Annotated[str, Field(pattern=_NAME, max_length=60)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


def _overrides(given: Any) -> Any:
    """Turn keys and values, nested or dotted, into ``key=value`` each; leave a list as it is."""
    if isinstance(given, Mapping):
        return tuple(f"{key}={json.dumps(value)}" for key, value in _dotted(given, ""))
    if given is None:
        return ()
    return tuple(given) if isinstance(given, list) else given


def _dotted(values: Mapping[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


Overrides = Annotated[tuple[str, ...], BeforeValidator(_overrides)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Entry(_Model):
    """Scenarios, or a bag with truth, to be measured with every variant."""

    scenario: str | None = Field(
        default=None,
        min_length=1,
        description="Name of a scenario that comes with the package, a pattern of such names "
        '("*": all), or a YAML file',
    )
    without: tuple[str, ...] = Field(
        default=(), description="Scenarios left out of those the pattern stands for"
    )
    bag: str | None = Field(
        default=None, min_length=1, description="A bag with truth, in place of it"
    )
    name: Name | None = Field(
        default=None, description="In the table; else the scenario's or the bag's own name"
    )
    seeds: tuple[Seed, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description="Else the scenario's own seed alone",
    )
    set_: Overrides = Field(default=(), alias="set", description="Values of the scenario")
    settings: Overrides = Field(default=(), description="Settings of the replay")
    variants: tuple[Name, ...] | None = Field(
        default=None, min_length=1, description="Else every variant of the manifest"
    )

    @property
    def is_pattern(self) -> bool:
        """Whether it stands for any number of scenarios."""
        return self.scenario is not None and any(sign in self.scenario for sign in "*?[")

    @model_validator(mode="after")
    def _fits_together(self) -> Entry:
        if (self.scenario is None) == (self.bag is None):
            raise ValueError("expected either `scenario: NAME` or `bag: PATH`")
        for key in ("seeds", "set"):
            if self.bag is not None and getattr(self, {"set": "set_"}.get(key, key)):
                raise ValueError(f"{key} is for a scenario; a bag is as it is")
        if self.without and not self.is_pattern:
            raise ValueError('without is for a pattern of scenarios, such as `scenario: "*"`')
        if self.name is not None and self.is_pattern:
            raise ValueError("a pattern of scenarios takes no name; each has its own")
        for key, values in (("seeds", self.seeds), ("variants", self.variants)):
            twice = [value for n, value in enumerate(values or ()) if value in (values or ())[:n]]
            if twice:
                raise ValueError(f"{key} has {twice[0]} twice; leave one of them")
        return self


class Manifest(_Model):
    """A benchmark."""

    description: str = Field(default="", description="What it is for, in one line")
    settings: Overrides = Field(default=(), description="Settings of every replay")
    set_: Overrides = Field(default=(), alias="set", description="Values of every scenario")
    runs: tuple[Entry, ...] = Field(
        min_length=1, max_length=1000, description="What is measured, each with every variant"
    )
    variants: dict[Name, Overrides] = Field(
        default={"default": ()},
        min_length=1,
        max_length=1000,
        description="Settings of the replay under a name; `default: {}` changes none",
    )

    @model_validator(mode="after")
    def _has_variants(self) -> Manifest:
        for n, entry in enumerate(self.runs):
            for name in entry.variants or ():
                if name not in self.variants:
                    raise ValueError(
                        f"runs.{n}.variants has {name}, which is none of the manifest's variants: "
                        f"{', '.join(self.variants)}"
                    )
        return self


def find_manifest(name: Path) -> Path:
    """Return the file of a manifest: a path, or the name of one that comes with the package."""
    known = {file.stem: file for file in sorted((config_directory() / "benchmarks").glob("*.yaml"))}
    # A directory of that name may be what the benchmark wrote here before.
    if name.is_file() or str(name) not in known:
        return name
    return known[str(name)]


def read_manifest(path: Path) -> Manifest:
    """Read a manifest.

    Raises:
        ManifestError: it cannot be read, is no YAML, or a key or value is wrong; one line names
            the file, the key, the value and what was expected.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(_MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise ManifestError(
            f"{path}: no such manifest; give an existing YAML file, or a name of config/benchmarks"
        ) from None
    except OSError as error:
        raise ManifestError(
            f"{path}: cannot be read ({error.strerror}); give a readable YAML file"
        ) from None
    if len(raw) > _MAX_FILE_BYTES:
        raise ManifestError(f"{path}: larger than {_MAX_FILE_BYTES} bytes, expected a manifest")
    try:
        document = parse_yaml(raw, f"{path}: ")
    except SettingsError as error:
        raise ManifestError(str(error)) from None
    if not isinstance(document, dict):
        raise ManifestError(
            f"{path}: holds {shown(document)}, expected a manifest with `runs:` in it"
        )
    return _validated(path, document)


def _validated(path: Path, document: Mapping[Any, Any]) -> Manifest:
    try:
        # As JSON: strict about numbers and text, but a list may stand for a tuple.
        return Manifest.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        raise ManifestError(f"{path}: {_in_words(error.errors(include_url=False)[0])}") from None
    except (TypeError, ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: not plain keys and values ({error})") from None


def _in_words(error: Any) -> str:
    place = [str(part) for part in error["loc"] if part != "[key]"]
    key = ".".join(place)
    if error["type"] == "missing":
        return f"{key} is missing; expected a list of scenarios or bags under `{key}:`"
    if error["type"] == "extra_forbidden":
        model = Entry if place[0] == "runs" else Manifest
        known = [field.alias or name for name, field in model.model_fields.items()]
        near = difflib.get_close_matches(place[-1], known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
        return f"{key}={shown(error['input'])}: unknown key; {hint}"
    message = str(error["msg"]).removeprefix("Input ").replace("should be", "expected", 1)
    if error["type"] == "value_error":
        # Of a whole entry, which is not shown.
        text = message.removeprefix("Value error, ")
        return f"{key}: {text}" if key else text
    if error["type"] == "string_pattern_mismatch":
        message = "expected a name of letters, digits, '_', '-' and '.'"
    elif error["type"] == "tuple_type" and place[-1] not in ("runs", "seeds", "without"):
        message = "expected keys and values, or a list of key=value"
    return f"{key}={shown(error['input'])}: {message}"
