"""The settings model put into words: one row for each setting."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import annotated_types
from pydantic.fields import FieldInfo

from pipeline_tracker.settings import Section, Settings

Kind = Literal["number", "integer", "text", "boolean", "vector", "choice"]

_KIND_IN_WORDS = {
    "number": "a number",
    "integer": "an integer",
    "text": "a text",
    "boolean": "true or false",
    "vector": "a list of 3 finite numbers",
}


@dataclass(frozen=True)
class SettingRow:
    """One setting in words.

    Attributes:
        key: dotted name.
        kind: what kind of value it takes.
        default: its default; None where there is none (then it is required or optional).
        required: whether it must be given.
        optional: whether it may be left empty.
        minimum, maximum: inclusive bounds, or None.
        above: exclusive lower bound, or None.
        choices: the values of a choice.
        unit: unit, or empty.
        description: one sentence.
        live: nodes that take another value while they run.
    """

    key: str
    kind: Kind
    default: Any
    required: bool
    optional: bool
    minimum: float | None
    maximum: float | None
    above: float | None
    choices: tuple[Any, ...]
    unit: str
    description: str
    live: tuple[str, ...] = ()

    @property
    def range(self) -> str:
        """The allowed values in words; empty where any will do."""
        if self.kind == "choice":
            return "one of " + ", ".join(str(c) for c in self.choices)
        parts = []
        if self.above is not None:
            parts.append(f"above {self.above:g}")
        if self.minimum is not None and self.kind != "text":
            parts.append(f"at least {_plain(self.minimum)}")
        if self.maximum is not None:
            parts.append(f"at most {_plain(self.maximum)}")
        if self.kind == "text" and self.minimum:
            parts.append("not empty")
        return ", ".join(parts)

    @property
    def type(self) -> str:
        """The type in words, without bounds."""
        return self.range if self.kind == "choice" else _KIND_IN_WORDS[self.kind]

    @property
    def expected(self) -> str:
        """Type, range and unit in words, as an error says them."""
        words = self.type
        if self.range and self.kind != "choice":
            words += f", {self.range}"
        return f"{words} ({self.unit})" if self.unit else words


@lru_cache(maxsize=1)
def describe_settings() -> tuple[SettingRow, ...]:
    """Return one row for each setting, in the order of the model."""
    return tuple(_rows(Settings, ""))


def _rows(section: type[Section], prefix: str) -> Iterator[SettingRow]:
    for name, field in section.model_fields.items():
        key = f"{prefix}{name}"
        if isinstance(field.annotation, type) and issubclass(field.annotation, Section):
            yield from _rows(field.annotation, f"{key}.")
        else:
            yield _row(key, field)


def _row(key: str, field: FieldInfo) -> SettingRow:
    annotation: Any = field.annotation
    optional = type(None) in typing.get_args(annotation)
    if optional:
        annotation = next(a for a in typing.get_args(annotation) if a is not type(None))
    choices: tuple[Any, ...] = ()
    if typing.get_origin(annotation) is Literal:
        kind: Kind = "choice"
        choices = typing.get_args(annotation)
    elif annotation in (bool, int, float, str):
        names: dict[Any, Kind] = {
            bool: "boolean",
            int: "integer",
            float: "number",
            str: "text",
        }
        kind = names[annotation]
    else:
        kind = "vector"
    bounds: dict[str, Any] = {}
    for mark in field.metadata:
        if isinstance(mark, annotated_types.Gt):
            bounds["above"] = mark.gt
        elif isinstance(mark, annotated_types.Ge):
            bounds["minimum"] = mark.ge
        elif isinstance(mark, annotated_types.Le):
            bounds["maximum"] = mark.le
        elif isinstance(mark, annotated_types.MinLen):
            bounds["minimum"] = mark.min_length
    required = field.is_required()
    default = None if required else field.default
    extra: dict[str, Any] = (
        field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    )
    return SettingRow(
        key=key,
        kind=kind,
        default=list(default) if isinstance(default, tuple) else default,
        required=required,
        optional=optional,
        minimum=bounds.get("minimum"),
        maximum=bounds.get("maximum"),
        above=bounds.get("above"),
        choices=choices,
        unit=str(extra.get("unit", "")),
        description=str(field.description),
        live=tuple(extra.get("live", ())),
    )


def _plain(number: float) -> str:
    return str(int(number)) if float(number).is_integer() else f"{number:g}"
