"""Sources of a pack, folders of ``avrare run``, ``check`` and ``rate``, and the claims that they support."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

from pydantic import AliasPath, BaseModel, BeforeValidator, Field

from avrare.analysis.check.criteria import Criterion, Decision
from avrare.analysis.rates.catalogue import Catalogue
from avrare.analysis.rates.catalogue_document import CatalogueDocument
from avrare.analysis.rates.rate import RATES, REFERENCE
from avrare.analysis.rates.rates import CatalogueRates, RuleRate, compute
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import UsageError
from avrare.base.number_format import format_percent, format_probability
from avrare.base.stored_files import read_model
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import judge
from avrare.results.run import RESULT, Run
from avrare.scenario.fingerprint import fingerprint

CHECK, MANIFEST = "check.json", "manifest.json"
_HINT = "give a folder that avrare run, check or rate has written"
_BALANCES = {"positive": "pass", "negative": "fail", "not known": "inconclusive"}
"""Risk balance -> verdict on the claim that the stack breaks a rule less often."""
Estimate = tuple[float, float, float, float]
"""Value, interval and its confidence; of a rate with exposures taken as known."""
_Ends = BeforeValidator(lambda ends: ends and [math.inf if end is None else end for end in ends])
"""Reader of the interval of a change, of which null stands for an infinite end."""


@dataclass(frozen=True)
class _StoredDecision(Decision):
    change_interval: Annotated[Interval | None, _Ends] = None


class _Summary(BaseModel):
    """Content of check.json or rate.json, but for what follows from the results of the runs."""

    rows: tuple[_StoredDecision, ...] = ()
    baselines: dict[str, Path] = {}
    document: CatalogueDocument | None = None
    driver: str = Field("", validation_alias=AliasPath("reference", "driver"))


@dataclass(frozen=True)
class Source:
    """Folder with results.

    Attributes:
        name: Name of the scenario or catalogue; unique in a pack.
        folder: The folder.
        file: File in it that has all its numbers.
        runs: Its runs by their names in the pack, ``NAME`` or ``NAME/scenes/wet``.
        summary: Verdicts and baselines of a check; document of a catalogue, and driver that it compares with.
    """

    name: str
    folder: Path
    file: str
    runs: Mapping[str, Run]
    summary: _Summary

    @cached_property
    def rates(self) -> CatalogueRates | None:
        """Rates of a catalogue, and of the driver that it is compared with; None for runs and checks."""
        document, driver, sides = self.summary.document, self.summary.driver, list[CatalogueRates]()
        if document is None:
            return None
        for place in (self.name, f"{self.name}/{REFERENCE}"):
            estimates = [
                {
                    rule: SceneEstimate(result, phase == "own")
                    for phase in ("own", "scenes")
                    for rule, result in self.runs.get(f"{place}/{phase}/{scene.name}", {}).items()
                }
                for scene in document.scenes
            ]
            rules = tuple(rule for rule in estimates[0] if all(rule in scene for scene in estimates))
            sides.append(compute(Catalogue(RATES, document, rules, (), ()), estimates))
        return replace(sides[0], driver=driver, reference=sides[1] if driver else None)


def read_sources(folders: Sequence[Path]) -> list[Source]:
    """Read the folders of a pack that is to be written.

    Raises:
        UsageError: One has no finished result, its files have changed since, or two have the same name.
    """
    sources = [read_source(folder) for folder in folders]
    for source in sources:
        for run in source.runs.values():
            _refuse_changes(run, source.summary.baselines.get(run.name))
    names = [source.name for source in sources]
    if doubles := [name for name in names if names.count(name) > 1]:
        text = f"two of the results are named {doubles[0]!r}"
        raise UsageError(text, "give each scenario a name of its own")
    return sources


def read_source(folder: Path) -> Source:
    """Read a folder of results, or its copy in a pack.

    Raises:
        UsageError: It has no finished result, or a file in it is damaged.
    """
    paths = sorted(folder.rglob(RESULT))
    places = [path.parent for path in paths if "pilot" not in path.relative_to(folder).parts]
    if not places or (folder / MANIFEST).is_file():
        raise UsageError(f"{folder}: {'is a pack itself' if places else 'no result in it'}", _HINT)
    runs = {place.relative_to(folder).as_posix(): Run.read(place) for place in places}
    file = next((name for name in (RATES, CHECK) if (folder / name).is_file()), RESULT)
    if file == RESULT and len(runs) > 1:
        raise UsageError(f"{folder}: holds {len(runs)} runs", f"give one of them: {', '.join(runs)}")
    summary = _Summary.model_validate({}) if file == RESULT else read_model(_Summary, folder / file, _HINT)
    if file != RESULT and not summary.rows and summary.document is None:
        raise UsageError(f"{folder / file}: holds no verdicts", _HINT)
    names = dict.fromkeys(run.name for run in runs.values())
    name = "-".join(names) if summary.document is None else summary.document.name
    named = {f"{name}/{place}".removesuffix("/."): run for place, run in runs.items()}
    return Source(name, folder, file, named, summary)


def _refuse_changes(run: Run, baseline: Path | None) -> None:
    reasons = [*run.changes]
    if run.definition is None:
        reasons.append(f"{run.folder}: its scenario cannot be loaded: {run.build_errors[0]}")
    elif fingerprint(run.definition) != run.fingerprint and not reasons:
        text = "versions or files that its options name are missing, or have changed since the run"
        reasons.append(f"{run.folder}: {text}")
    if baseline is not None and not baseline.is_file():
        reasons.append(f"{baseline}: the baseline of {run.name} is missing")
    if reasons:
        hint = "run it again; relative paths in its options are those of the folder from which it was called"
        raise UsageError("; ".join(reasons), hint)


@dataclass(frozen=True)
class Measure:
    """Numbers of a claim; ``bound`` and ``verdict`` are None where no bound is set."""

    rule: str
    value: float | None
    low: float
    high: float
    bound: str | None = None
    verdict: str | None = None
    unit: str = ""
    blind: float | None = None

    @property
    def bound_in_words(self) -> str:
        """Bound, else the measured upper end."""
        return self.bound or f"at most {format_probability(self.high)} {self.unit}".rstrip()


@dataclass(frozen=True)
class Claim:
    """Claim on one rule: its text and numbers, an estimate that can be repeated, and the results behind it.

    The estimate has the name of the run, catalogue or driver that it is of; results have those of their runs.
    """

    text: str
    measure: Measure
    name: str
    estimate: Estimate
    results: Mapping[str, Result]


def list_claims(source: Source) -> Iterator[Claim]:
    """Yield the claims of a source: one for each bound, and for each rule without any."""
    if source.rates is not None:
        yield from _claim_rates(source, source.rates)
        return
    for name, run in source.runs.items():
        for rule, result in run.items():
            estimate = (result.probability, *result.interval, result.confidence)
            unbounded = Measure(rule, *estimate[:3], blind=result.blind_bound)
            for measure in [*_measure_bounds(source, run, unbounded)] or [unbounded]:
                text = f"{run.name}: the probability that a drive breaks {rule} is {measure.bound_in_words}"
                level = "" if " at 0." in text else f", at {format_percent(result.confidence)}"
                yield Claim(text + level, measure, name, estimate, {name: result})


def _measure_bounds(source: Source, run: Run, measure: Measure) -> Iterator[Measure]:
    for bound in run.thresholds(measure.rule) if source.file == RESULT else ():
        question = Criterion(run.name, measure.rule, bound).question
        yield replace(measure, bound=question, verdict=judge(run[measure.rule], bound))
    for row in source.summary.rows:
        if (row.scenario, row.specification) == (run.name, measure.rule) and row.question != "baseline":
            value, ends, unit = row.probability, row.interval, ""
            if row.kind == "regression":
                value, ends, unit = row.change, row.change_interval, "times"
            low, high = ends or (0.0, math.inf)
            asked = replace(measure, bound=row.question, verdict=row.verdict, unit=unit)
            yield replace(asked, value=value, low=low, high=high)


def _claim_rates(source: Source, rates: CatalogueRates) -> Iterator[Claim]:
    name, confidence = source.name, rates.catalogue.document.confidence
    for rate in rates.rates:
        results = _list_results(source, rate.rule, f"{name}/own/", f"{name}/scenes/")
        for row in rate.decisions or (None,):
            unit = row.threshold.unit if row is not None else next(iter(rate.totals))
            bound, verdict = (row.threshold.text, row.verdict) if row is not None else (None, None)
            total, blind = rate.totals[unit], rate.blind.get(unit)
            measure = Measure(rate.rule, total.value, *total.interval, bound, verdict, f"per {unit}", blind)
            text = f"the rate of drives that break {rate.rule} is {measure.bound_in_words}"
            text = f"{name}: {text}, at {format_percent(confidence)}"
            yield Claim(text, measure, name, _estimate(rate, confidence), results)
    for balance, rate in zip(rates.balances, rates.reference.rates if rates.reference else (), strict=True):
        value, verdict = (None if math.isnan(balance.ratio) else balance.ratio), _BALANCES[balance.verdict]
        ends, estimate = balance.interval, _estimate(rate, confidence)
        measure = Measure(rate.rule, value, *ends, "less often", verdict, "times as often")
        text = f"{name}: the stack breaks {rate.rule} less often than {rates.driver}"
        yield Claim(text, measure, f"{name}/{REFERENCE}", estimate, _list_results(source, rate.rule, name))


def _list_results(source: Source, rule: str, *places: str) -> dict[str, Result]:
    return {name: run[rule] for name, run in source.runs.items() if name.startswith(places) and rule in run}


def _estimate(rate: RuleRate, confidence: float) -> Estimate:
    total = next(iter(rate.totals.values()))
    return (total.value, *total.sampling, confidence)
