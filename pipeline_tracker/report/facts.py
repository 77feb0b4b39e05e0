"""run.json: what only the replay itself knows of how it went."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pipeline_tracker.errors import BagError, PipelineTrackerError

FILE_NAME = "run.json"
_Model = TypeVar("_Model", bound=BaseModel)


class RunFacts(BaseModel):
    """How a replay went; without this file in its directory it was cut off."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    version: str = Field(description="Version of pipeline_tracker")
    bag: str = Field(description="Name of the bag")
    frames_expected: int = Field(description="Left images in the bag by its own summary")
    interrupted: bool = Field(description="It was interrupted; the frames before are there")
    damage: str = Field(description="What ended it early: the bag's damage; empty: nothing did")
    seconds: float = Field(description="What it took, s")
    notes: list[str] = Field(description="What the summary says of poses, images and warnings")


def write_facts(directory: Path, facts: RunFacts) -> None:
    """Write run.json.

    Raises:
        OSError: it cannot be written.
    """
    # Names of files may hold bytes that are no text.
    text = facts.model_copy(update={"bag": _readable(facts.bag), "damage": _readable(facts.damage)})
    path = directory / FILE_NAME
    path.write_text(text.model_dump_json(indent=2) + "\n", encoding="utf-8")


def read_facts(directory: Path) -> RunFacts | None:
    """Read run.json; None where there is none.

    Raises:
        BagError: it is damaged.
    """
    return read_document(directory / FILE_NAME, RunFacts, BagError, "replay again")


def read_document(
    path: Path, model: type[_Model], error: type[PipelineTrackerError], advice: str
) -> _Model | None:
    """Read a JSON file into its model; None where there is no file.

    Args:
        path: the file.
        model: its schema.
        error: what to raise.
        advice: what to do where it is damaged, beside deleting it.

    Raises:
        PipelineTrackerError: an ``error``: it cannot be read, or does not fit the model.
    """
    try:
        return model.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from None
    except ValidationError as reason:
        first = reason.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise error(
            f"{path}: damaged or of another version ({where}: {first['msg']}); {advice}, or "
            "delete it"
        ) from None


def _readable(text: str) -> str:
    return text.encode("utf-8", "replace").decode("utf-8")
