"""Kinds of values that the models of a scenario share."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

Share = Annotated[float, Field(ge=0, le=1)]
Colour = tuple[Share, Share, Share]
Coefficient = Annotated[float, Field(ge=0, le=20)]
Coefficients = tuple[Coefficient, Coefficient, Coefficient]
Gain = Annotated[float, Field(gt=0, le=10)]
Gains = tuple[Gain, Gain, Gain]


def value(default: Any, description: str, *, unit: str = "", **bounds: Any) -> Any:
    """Return a field of a model: its default, what it means, its unit and its bounds."""
    extra: dict[str, Any] = {"unit": unit}
    return Field(default, description=description, json_schema_extra=extra, **bounds)
