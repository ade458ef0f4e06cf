"""Sources of a pack: folders of ``avrare run``, ``avrare check`` and ``avrare rate``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator

from avrare.analysis.check.criteria import Decision
from avrare.analysis.rates.catalogue import Catalogue
from avrare.analysis.rates.catalogue_document import CatalogueDocument
from avrare.analysis.rates.rate import RATES, REFERENCE
from avrare.analysis.rates.rates import CatalogueRates, compute
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_model
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.results.run import RESULT, Run
from avrare.scenario.fingerprint import fingerprint

CHECK, MANIFEST = "check.json", "manifest.json"
_HINT = "give a folder that avrare run, check or rate has written"


@dataclass(frozen=True)
class _StoredDecision(Decision):
    """Verdict in check.json, where null stands for an infinite end."""

    change_interval: Annotated[
        Interval | None,
        BeforeValidator(lambda ends: [math.inf if end is None else end for end in ends or ()] or None),
    ] = None


class _StoredCheck(BaseModel):
    rows: tuple[_StoredDecision, ...]


class _Driver(BaseModel):
    driver: str


class _StoredRates(BaseModel):
    document: CatalogueDocument
    reference: _Driver | None = None


@dataclass(frozen=True)
class Source:
    """Folder with results.

    Attributes:
        name: Name of the scenario or catalogue; unique in a pack.
        folder: The folder.
        runs: Its runs, by their place in the folder with a slash behind it: "" or "scenes/wet/".
        file: File with the verdicts.
        rows: Verdicts of a check.
        rates: Rates of a catalogue.
    """

    name: str
    folder: Path
    runs: dict[str, Run]
    file: str = RESULT
    rows: tuple[Decision, ...] = ()
    rates: CatalogueRates | None = None

    @property
    def home(self) -> str:
        """Folder of the source in the pack."""
        return f"evidence/{self.name}/"


def read_sources(folders: Sequence[Path]) -> list[Source]:
    """Read the folders.

    Raises:
        UsageError: One has no finished result, its files have changed since, or two have the same name.
    """
    sources = [_read_source(folder) for folder in folders]
    names = [source.name for source in sources]
    if doubles := [name for name in names if names.count(name) > 1]:
        raise UsageError(
            f"two of the results are named {doubles[0]!r}", "give each scenario a name of its own"
        )
    return sources


def _read_source(folder: Path) -> Source:
    if (folder / MANIFEST).is_file():
        raise UsageError(f"{folder}: is a pack itself", _HINT)
    results = [path.parent for path in sorted(folder.rglob(RESULT)) if "pilot" not in path.parts]
    if not results:
        raise UsageError(f"{folder}: no result in it", _HINT)
    runs = {f"{path.relative_to(folder).as_posix()}/".removeprefix("./"): _read_run(path) for path in results}
    if (folder / RATES).is_file():
        rates = read_rates(folder / RATES, runs)
        return Source(rates.catalogue.document.name, folder, runs, RATES, rates=rates)
    name = "-".join(dict.fromkeys(run.name for run in runs.values()))
    if (folder / CHECK).is_file():
        return Source(
            name,
            folder,
            runs,
            CHECK,
            read_model(_StoredCheck, folder / CHECK, _HINT).rows,
        )
    if len(runs) > 1:
        raise UsageError(f"{folder}: holds {len(runs)} runs", f"give one of them: {', '.join(runs)}")
    return Source(name, folder, runs)


def _read_run(folder: Path) -> Run:
    run = Run.read(folder)
    if run.changes:
        raise UsageError("; ".join(run.changes), "evidence is of files as they were written: run it again")
    if run.definition is None:
        hint = "run it again; relative paths in its options are those of the folder from which it was called"
        raise UsageError(f"{folder}: its scenario cannot be loaded: {run.build_errors[0]}", hint)
    if fingerprint(run.definition) != run.fingerprint:
        text = f"{folder}: versions or files that its options name are missing, or have changed since the run"
        again = "run it again; relative paths in its options are those of the folder from which it was called"
        raise UsageError(text, again)
    return run


def read_rates(file: Path, results: Mapping[str, Mapping[str, Result]]) -> CatalogueRates:
    """Return the rates of a catalogue, whose rate.json is given, from the results of its runs by place.

    Raises:
        UsageError: The file is damaged.
    """
    stored = read_model(_StoredRates, file, _HINT)

    def compute_below(folder: str) -> CatalogueRates:
        estimates = [
            {
                rule: SceneEstimate(result, phase == "own")
                for phase in ("own", "scenes")
                for rule, result in results.get(f"{folder}{phase}/{scene.name}/", {}).items()
            }
            for scene in stored.document.scenes
        ]
        rules = tuple(rule for rule in estimates[0] if all(rule in scene for scene in estimates))
        return compute(Catalogue(file.name, stored.document, rules, (), ()), estimates)

    rates = compute_below("")
    if stored.reference is None:
        return rates
    return replace(rates, driver=stored.reference.driver, reference=compute_below(f"{REFERENCE}/"))
