"""Claims of a source, their premises, and the challenges of both."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import mean, variance
from typing import Any

from avrare.analysis.check.criteria import Criterion
from avrare.analysis.rates.rates import CatalogueRates
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.number_format import format_interval, format_percent, format_probability
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import judge
from avrare.results.run import RESULT, Run
from avrare_evidence.sources import Source

_STATES = {
    "pass": "holds",
    "pass_assuming": "holds as far as the search could see",
    "inconclusive": "not shown",
    "fail": "refuted",
    None: "measured, no bound asked",
}
"""Verdict -> state of a claim."""
_OF_BALANCES = {"positive": "pass", "negative": "fail", "not known": "inconclusive"}
"""Verdict of a risk balance -> that of the claim on it."""


@dataclass(frozen=True)
class Challenge:
    """Reason to doubt a statement.

    Attributes:
        text: The reason.
        url: File of the pack with the evidence, and the key in it behind ``#``; empty where there is none.
        decides: Whether the verdict would be another without it.
        answer: Reason against the challenge; empty where there is none.
    """

    text: str
    url: str = ""
    decides: bool = False
    answer: str = ""


@dataclass(frozen=True)
class Measure:
    """Numbers of a claim; ``bound`` and ``verdict`` are None where no bound is set."""

    rule: str
    value: float | None
    low: float
    high: float
    unit: str = ""
    blind: float | None = None
    bound: str | None = None
    verdict: str | None = None

    @property
    def state(self) -> str:
        """State of the claim in words."""
        return _STATES[self.verdict]


@dataclass(frozen=True)
class Statement:
    """Claim on one rule, or premise of claims.

    Attributes:
        kind: Kind in the notation: "G", a claim; "C", a context; "A", an assumption.
        text: The statement.
        challenges: Reasons to doubt it.
        layers: Content of a premise for programs, by key.
        file: File of the pack that supports a claim.
        measure: Numbers of a claim; None for a premise.
    """

    kind: str
    text: str
    challenges: tuple[Challenge, ...]
    layers: Mapping[str, object] = field(default_factory=dict)
    file: str = ""
    measure: Measure | None = None

    @property
    def is_defeated(self) -> bool:
        """Whether a challenge decides the verdict."""
        return any(challenge.decides for challenge in self.challenges)


def list_claims(source: Source) -> list[Statement]:
    """Return the claims of a source: one for each bound, and for each rule without any."""
    claims = _claim_probabilities(source) if source.rates is None else _claim_rates(source, source.rates)
    return list(claims)


def _claim_probabilities(source: Source) -> Iterator[Statement]:
    for place, run in source.runs.items():
        for rule, result in run.items():
            for measure in _list_measures(source, run, result):
                has_level = " at 0." in (measure.bound or "")
                level = "" if has_level else f", at {format_percent(result.confidence)}"
                text = f"{run.name}: the probability that a drive breaks {rule} is {{}}{level}"
                yield _claim(source, text, measure, f"{place}{RESULT}", place)


def _list_measures(source: Source, run: Run, result: Result) -> list[Measure]:
    rule, blind = result.specification, result.blind_bound
    if source.rows:
        measures = [
            Measure(rule, *row.numbers, blind, row.question, row.verdict)
            for row in source.rows
            if (row.scenario, row.specification) == (run.name, rule) and row.question != "baseline"
        ]
    else:
        numbers = (rule, result.probability, *result.interval, "", blind)
        measures = [
            Measure(*numbers, Criterion(run.name, rule, bound).question, judge(result, bound))
            for bound in run.thresholds(rule)
        ]
    return measures or [Measure(rule, result.probability, *result.interval, "", blind)]


def _claim_rates(source: Source, rates: CatalogueRates) -> Iterator[Statement]:
    level = format_percent(rates.catalogue.document.confidence)
    for rate in rates.rates:
        for decision in rate.decisions or [None]:
            unit = decision.threshold.unit if decision else next(iter(rate.totals))
            total, bounds = rate.totals[unit], (decision.threshold.text, decision.verdict) if decision else ()
            numbers = (total.value, *total.interval, f"per {unit}", rate.blind.get(unit))
            text = f"{source.name}: the rate of drives that break {rate.rule} is {{}}, at {level}"
            yield _claim(source, text, Measure(rate.rule, *numbers, *bounds), source.file, "own/", "scenes/")
    for balance in rates.balances:
        ratio = None if math.isnan(balance.ratio) else balance.ratio
        low, high = balance.interval
        verdict = _OF_BALANCES[balance.verdict]
        text = f"{source.name}: the stack breaks {balance.rule} {{}} than {rates.driver}"
        measure = Measure(balance.rule, ratio, low, high, "times as often", None, "less often", verdict)
        yield _claim(source, text, measure, source.file, "")


def _claim(source: Source, text: str, measure: Measure, file: str, *places: str) -> Statement:
    """Return the claim whose ``text`` the bound completes, and that runs below ``places`` support."""
    runs = {place: run for place, run in source.runs.items() if place.startswith(places)}
    results = {place: run[measure.rule] for place, run in runs.items() if measure.rule in run}
    doubts = [
        doubt
        for place, result in results.items()
        for doubt in _doubt_result(
            result,
            f"{source.home}{place}{RESULT}",
            result.health if source.rates is None else SceneEstimate(result).warnings,
            measure.verdict == "inconclusive",
        )
    ]
    file = source.home + file
    interval = f"The interval {format_interval((measure.low, measure.high))} {measure.unit}".rstrip()
    if measure.verdict == "fail":
        doubts.append(Challenge(f"{interval} does not keep to {measure.bound}", f"{file}#interval", True))
    elif measure.verdict == "inconclusive" and not any(doubt.decides for doubt in doubts):
        doubts.append(Challenge(f"{interval} reaches past {measure.bound}", f"{file}#interval", True))
    if measure.blind is not None:
        doubts.append(_doubt_search(measure, f"{file}#blind_bound", list(results.values())))
    bound = measure.bound or f"at most {format_probability(measure.high)} {measure.unit}".rstrip()
    return Statement("G", text.format(bound), tuple(doubts), {"measure": asdict(measure)}, file, measure)


def _doubt_result(
    result: Result, file: str, warnings: Mapping[str, str], is_open: bool
) -> Iterator[Challenge]:
    for name, message in warnings.items():
        yield Challenge(f"Warning {name}: {message}", f"{file}#warnings.{name}", is_open)
    check = result.cross_check
    if check is not None and check.outcome == "inconclusive":
        yield Challenge(f"The cross-check by {check.estimator} could not decide", f"{file}#cross_check")
    if result.errors:
        text = f"{result.errors:,} of {result.rollouts:,} rollouts broke down; they count against both ends"
        yield Challenge(text, f"{file}#errors")
    for note in result.notes:
        if note.kind in ("model", "goal"):
            yield Challenge(note.text, f"{file}#notes")


def _doubt_search(measure: Measure, url: str, results: Sequence[Result]) -> Challenge:
    bound = f"{format_probability(measure.blind or 0.0)} {measure.unit}".rstrip()
    text = f"Failures that the search is not led to could be as likely as {bound}"
    checks = [result.cross_check for result in results if result.blind_bound is not None]
    agreeing = [check.estimator for check in checks if check is not None and check.outcome == "agree"]
    names = ", ".join(dict.fromkeys(agreeing))
    answer = f"A second estimate, by {names}, agrees" if len(agreeing) == len(checks) else ""
    return Challenge(text, url, measure.verdict == "pass_assuming", answer)


def list_premises(source: Source, sheets: Mapping[str, Mapping[str, Any]]) -> Iterator[Statement]:
    """Yield the premises of a source's claims; ``sheets`` are those of its runs, by path."""
    tags = ("objective", "requirements", "odd")
    scenarios = {path: {tag: sheet[tag] for tag in tags} for path, sheet in sheets.items()}
    names = ", ".join(dict.fromkeys(run.name for run in source.runs.values()))
    yield _state("C", f"Scenarios: {names}", _doubt_scenarios(source), scenarios=scenarios)
    if laws := {path: sheet["inputs"]["laws"] for path, sheet in sheets.items() if sheet["inputs"]["laws"]}:
        yield _state("A", f"{source.name}: starts follow the laws of the drawn options", (), laws=laws)
    if source.rates is not None:
        met = zip(source.rates.catalogue.document.scenes, source.rates.exposures, strict=True)
        exposures = {
            scene.name: {
                **asdict(quantity),
                "unit": scene.unit,
                "stated": scene.exposure and scene.exposure.model_dump(mode="json", exclude_defaults=True),
            }
            for scene, quantity in met
        }
        text = f"{source.name}: scenes are met as often as stated"
        yield _state("A", text, _doubt_exposures(source.rates), exposures=exposures)


def _state(kind: str, text: str, doubts: Iterable[str], **layers: object) -> Statement:
    return Statement(kind, text, tuple(map(Challenge, dict.fromkeys(doubts))), layers)


def _doubt_scenarios(source: Source) -> Iterator[str]:
    for run in source.runs.values():
        warnings = run.definition.warnings if run.definition is not None else ()
        yield from (message.partition(": ")[2] or message for message, _ in warnings)
        if run.provenance.uncommitted_changes is not False:
            yield "The repository had changes that no commit has: the commit does not identify the files"
    yield from (row.reason for row in source.rows if row.question == "baseline")


def _doubt_exposures(rates: CatalogueRates) -> Iterator[str]:
    from scipy.special import chdtri

    for scene in rates.catalogue.document.scenes:
        name, exposure = scene.name, scene.exposure
        if exposure is None:
            yield f"Scene {name} has no exposure: shares of cells of a grid say nothing on rates of the road"
        elif exposure.counts and sum(exposure.counts):
            scatter, freedom = variance(exposure.counts) / mean(exposure.counts), len(exposure.counts) - 1
            if scatter * freedom > chdtri(freedom, 0.05):
                text = f"its counts scatter {scatter:.2g} times as much as Poisson's"
                yield f"Scene {name}: {text}: its interval is widened by that, if the blocks are independent"
        elif exposure.count is None and exposure.interval is None:
            yield f"Scene {name}: its exposure is stated without an interval, and counts as known exactly"
