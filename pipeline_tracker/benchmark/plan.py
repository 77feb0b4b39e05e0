"""From a manifest to single tasks: seas to simulate, replays to measure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.benchmark.fingerprint import (
    bag_fingerprint,
    hash_of,
    measuring_code,
    simulator_code,
)
from pipeline_tracker.benchmark.geometry import Geometry, of_scenario
from pipeline_tracker.benchmark.manifest import Entry, Manifest
from pipeline_tracker.errors import ManifestError, PipelineTrackerError, SettingsError
from pipeline_tracker.evaluation.truth import scenario_of
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dump_settings, load_settings
from pipeline_tracker.simulation import list_scenarios, load_scenario
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import dump_scenario

_MOST_RUNS = 10_000


@dataclass(frozen=True)
class SeaTask:
    """A sea to simulate.

    Attributes:
        name: the scenario's name in the table.
        seed: its seed.
        scenario: all its values, as YAML.
        directory: where the bag is or goes, below the benchmark's directory; ends with the key.
        code: hash of the code that has to make it.
    """

    name: str
    seed: int
    scenario: str
    directory: str
    code: str

    @property
    def label(self) -> str:
        """What a person calls it."""
        return f"sea {self.name}, seed {self.seed}"


@dataclass(frozen=True)
class RunTask:
    """A replay to measure.

    Attributes:
        name: the scenario's or the bag's name in the table.
        seed: of the scenario; None for a bag.
        variant: name of the settings.
        settings: all of them, as YAML.
        bag: absolute path of the bag; empty where it is ``sea``'s.
        sea: the sea to be simulated first, or None.
        geometry: stated beside the figures; None for a bag, whose evaluation tells it.
        directory: where the result is or goes, below the benchmark's directory.
        code: hash of the code that has to measure it.
    """

    name: str
    seed: int | None
    variant: str
    settings: str
    bag: str
    sea: SeaTask | None
    geometry: Geometry | None
    directory: str
    code: str

    @property
    def label(self) -> str:
        """What a person calls it."""
        seed = "" if self.seed is None else f", seed {self.seed}"
        return f"{self.name}{seed}, {self.variant}"


@dataclass
class Plan:
    """All tasks of a benchmark, in the manifest's order."""

    runs: list[RunTask] = field(default_factory=list)

    @property
    def seas(self) -> list[SeaTask]:
        """The seas of all runs, each once."""
        return list(dict.fromkeys(run.sea for run in self.runs if run.sea is not None))


@dataclass(frozen=True)
class _Subject:
    """What is replayed: a sea, or a bag as it is."""

    name: str
    scenario: Scenario | None = None
    bag: Path | None = None
    simulated: dict[str, Any] | None = None  # what the bag says of its scenario


def make_plan(manifest: Manifest, path: Path) -> Plan:
    """Work out all tasks of a manifest and check what can be checked before the work.

    Args:
        manifest: the manifest.
        path: its file; paths in it are relative to the file's directory.

    Raises:
        ManifestError: a scenario or a bag does not exist, a value or a setting is impossible, or
            two runs have one name.
    """
    plan, known = Plan(), tuple(list_scenarios())
    taken: dict[tuple[str, int | None, str], str] = {}
    for n, entry in enumerate(manifest.runs):
        place = f"{path}: runs.{n}"
        for subject in _subjects(manifest, entry, known, path.resolve().parent, place):
            for variant in entry.variants or manifest.variants:
                run = _run(manifest, entry, subject, variant, place)
                identity = (run.name.casefold(), run.seed, run.variant.casefold())
                if identity in taken:
                    raise ManifestError(
                        f"{place}: {run.label} is there already, by {taken[identity]}; "
                        "give one of the two another name, as in `name: calm`"
                    )
                taken[identity] = f"runs.{n}"
                plan.runs.append(run)
                if len(plan.runs) > _MOST_RUNS:
                    raise ManifestError(
                        f"{path}: more than {_MOST_RUNS} runs (entries x seeds x variants); "
                        "make several manifests of it"
                    )
    return plan


def _subjects(
    manifest: Manifest, entry: Entry, known: tuple[str, ...], here: Path, place: str
) -> Iterator[_Subject]:
    if entry.bag is not None:
        bag = here / entry.bag
        if not bag.exists():
            raise ManifestError(f"{place}.bag={entry.bag}: there is no {bag}; give an existing bag")
        name = _name(entry, bag, place)
        yield _Subject(name, bag=bag.resolve(), simulated=_scenario_of_bag(bag))
        return
    overrides = (*manifest.set_, *entry.set_)
    for name, scenario in _scenarios(entry, known, here, place):
        for seed in entry.seeds or (None,):
            try:
                loaded = load_scenario(scenario, overrides, seed)
            except SettingsError as error:
                raise ManifestError(
                    f"{place}, scenario {scenario}: {str(error).replace('--set ', '', 1)}"
                ) from None
            yield _Subject(name, loaded)


def _scenarios(
    entry: Entry, known: tuple[str, ...], here: Path, place: str
) -> Iterator[tuple[str, str | Path]]:
    """Yield the scenarios of an entry: name in the table, and name or path to load it by."""
    wanted = str(entry.scenario)
    if entry.is_pattern:
        for pattern in (wanted, *entry.without):
            if not any(fnmatchcase(name, pattern) for name in known):
                raise ManifestError(
                    f"{place}: no scenario is called {pattern}; there are {', '.join(known)}"
                )
        for name in known:
            left_out = any(fnmatchcase(name, pattern) for pattern in entry.without)
            if fnmatchcase(name, wanted) and not left_out:
                yield name, name
        return
    if wanted in known:
        yield entry.name or wanted, wanted
        return
    path = here / wanted
    if not path.is_file():
        raise ManifestError(
            f"{place}.scenario={wanted}: there is no such scenario and no file {path}; there are "
            f"{', '.join(known)}"
        )
    yield _name(entry, path, place), path


def _name(entry: Entry, path: Path, place: str) -> str:
    if entry.name is not None:
        return entry.name
    name = path.stem if path.is_file() else path.resolve().name
    try:
        return str(Entry(scenario="any", name=name).name)
    except ValueError:
        raise ManifestError(
            f"{place}: {name!r} is no name for a table; give one of letters, digits, '_', '-' "
            "and '.', as in `name: calm`"
        ) from None


def _run(manifest: Manifest, entry: Entry, subject: _Subject, variant: str, place: str) -> RunTask:
    changes = (*manifest.settings, *entry.settings, *manifest.variants[variant])
    settings = _settings(subject, changes, f"{place}, variant {variant}")
    scenario, bag = subject.scenario, subject.bag
    sea, seed = None, None
    if bag is None and scenario is not None:
        sea, seed = _sea(subject.name, scenario), scenario.seed
    text = dump_settings(settings)
    source = _fingerprint(bag, place) if bag is not None else sea and sea.directory
    key = hash_of(source, text, measuring_code())
    number = "" if seed is None else f"-{seed}"
    return RunTask(
        name=subject.name,
        seed=seed,
        variant=variant,
        settings=text,
        bag="" if bag is None else str(bag),
        sea=sea,
        geometry=None if scenario is None else of_scenario(scenario),
        directory=f"runs/{subject.name}{number}-{variant}-{key}",
        code=measuring_code(),
    )


def _fingerprint(bag: Path, place: str) -> list[list[Any]]:
    try:
        return bag_fingerprint(bag)
    except OSError as error:
        raise ManifestError(f"{place}: {bag} cannot be read ({error.strerror})") from None


def _settings(subject: _Subject, changes: tuple[str, ...], place: str) -> Settings:
    base = _of_subject(subject)
    given = {change.partition("=")[0].strip() for change in changes}
    if "pipe.diameter" not in {*base, *given}:
        raise ManifestError(
            f"{place}: pipe.diameter is missing, and the bag names no scenario to take it from; "
            "give it as in `settings: {pipe.diameter: 0.6}`"
        )
    try:
        return load_settings(None, changes, base)
    except SettingsError as error:
        raise ManifestError(f"{place}: {str(error).replace('--set ', '', 1)}") from None


def _of_subject(subject: _Subject) -> dict[str, Any]:
    """Return the settings that what is replayed asks for by itself."""
    if subject.scenario is not None:
        values = subject.scenario.model_dump()
    else:
        values = subject.simulated or {}
    pipe, camera = values.get("pipe", {}), values.get("camera", {})
    base: dict[str, Any] = {}
    if "diameter" in pipe:
        base["pipe.diameter"] = pipe["diameter"]
    if camera.get("mono"):
        base["mode"] = "mono"
    return base


def _scenario_of_bag(bag: Path) -> dict[str, Any] | None:
    try:
        with BagReader(bag) as reader:
            return scenario_of(reader)
    except PipelineTrackerError:
        # Its replay will say what is wrong with it.
        return None


def _sea(name: str, scenario: Scenario) -> SeaTask:
    # What it says of itself makes no other sea.
    values = scenario.model_dump(mode="json", exclude={"description"})
    key = hash_of(values, simulator_code())
    return SeaTask(
        name=name,
        seed=scenario.seed,
        scenario=dump_scenario(scenario),
        directory=f"seas/{name}-{key}",
        code=simulator_code(),
    )
