"""Argument of a pack: the claims of its sources, their premises, and the challenges of both."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from statistics import mean, variance
from typing import Any

from avrare.analysis.check.criteria import Criterion
from avrare.analysis.rates.catalogue_document import SceneEntry
from avrare.analysis.rates.rate import RATES
from avrare.analysis.rates.rates import CatalogueRates
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.number_format import format_interval, format_percent, format_probability
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import judge
from avrare.results.run import RESULT, Run
from avrare_evidence.gsn import Case, Measure, add_challenge, add_element
from avrare_evidence.sources import Source

Sheet = dict[str, Any]
"""Content of a test-case sheet."""
_FAULTS = {"fail": "does not keep to", "inconclusive": "reaches past"}
"""Verdict -> relation of the interval to the bound."""


@dataclass(frozen=True)
class Claim:
    """Claim on one rule, the file of the pack that supports it, and the results behind it by their files."""

    text: str
    measure: Measure
    file: str
    results: Mapping[str, Result]


def list_claims(source: Source) -> list[Claim]:
    """Return the claims of a source: one for each bound, and for each rule without any."""
    if source.rates is not None:
        return [*_claim_rates(source, source.rates)]
    claims = []
    for place, run in source.runs.items():
        for rule, result in run.items():
            unbounded = Measure(
                rule, result.probability, *result.interval, None, None, "", result.blind_bound
            )
            for measure in [*_measure_bounds(source, run, rule, unbounded)] or [unbounded]:
                subject = f"{run.name}: the probability that a drive breaks {rule} is"
                has_level = " at 0." in (measure.bound or "")
                level = "" if has_level else f", at {format_percent(result.confidence)}"
                claims.append(_make_claim(source, subject, level, measure, f"{place}{RESULT}", place))
    return claims


def _measure_bounds(source: Source, run: Run, rule: str, measure: Measure) -> Iterator[Measure]:
    for bound in run.thresholds(rule) if source.file == RESULT else ():
        question = Criterion(run.name, rule, bound).question
        yield replace(measure, bound=question, verdict=judge(run[rule], bound))
    for row in source.rows:
        if (row.scenario, row.specification) == (run.name, rule) and row.question != "baseline":
            is_change = row.kind == "regression"
            value, ends = (row.change, row.change_interval) if is_change else (row.probability, row.interval)
            low, high = ends or (0.0, math.inf)
            unit = "times" if is_change else ""
            yield Measure(rule, value, low, high, row.question, row.verdict, unit, measure.blind)


def _claim_rates(source: Source, rates: CatalogueRates) -> Iterator[Claim]:
    level = f", at {format_percent(rates.catalogue.document.confidence)}"
    for rate in rates.rates:
        for decision in rate.decisions or [None]:
            unit = decision.threshold.unit if decision else next(iter(rate.totals))
            measure = Measure(
                rate.rule,
                rate.totals[unit].value,
                *rate.totals[unit].interval,
                bound=decision.threshold.text if decision else None,
                verdict=decision.verdict if decision else None,
                unit=f"per {unit}",
                blind=rate.blind.get(unit),
            )
            subject = f"{source.name}: the rate of drives that break {rate.rule} is"
            yield _make_claim(source, subject, level, measure, source.file, "own/", "scenes/")
    for balance in rates.balances:
        ratio = None if math.isnan(balance.ratio) else balance.ratio
        low, high = balance.interval
        verdict = {"positive": "pass", "negative": "fail"}.get(balance.verdict, "inconclusive")
        measure = Measure(balance.rule, ratio, low, high, "less often", verdict, "times as often", None)
        subject = f"{source.name}: the stack breaks {balance.rule}"
        yield _make_claim(source, subject, f" than {rates.driver}", measure, source.file, "")


def _make_claim(source: Source, subject: str, end: str, measure: Measure, file: str, *places: str) -> Claim:
    """Return the claim that the runs below ``places`` support."""
    results = {
        f"{source.home}{place}{RESULT}": run[measure.rule]
        for place, run in source.runs.items()
        if place.startswith(places) and measure.rule in run
    }
    bound = measure.bound or f"at most {format_probability(measure.high)} {measure.unit}".rstrip()
    return Claim(f"{subject} {bound}{end}", measure, source.home + file, results)


def build_case(sources: Sequence[Source], sheets: Mapping[str, Sheet], digests: Mapping[str, str]) -> Case:
    """Return the argument: one goal above all, a strategy for each source, and a goal for each claim.

    Args:
        sources: Sources of the pack.
        sheets: Sheets of their test cases, by path.
        digests: SHA-256 of results and scenarios, by path.
    """
    case: Case = {}
    names = ", ".join(source.name for source in sources)
    top = add_element(case, "G", f"The stack keeps the rules of {names} as often as claimed")
    for source in sources:
        premises = list(_add_premises(case, source, sheets, digests))
        text = f"{source.name}: estimate how often each rule is broken; a verdict needs the whole interval"
        strategy = add_element(case, "S", text, in_context_of=premises)
        case[top].supported_by.append(strategy)
        run, solutions = next(iter(source.runs.values())), dict[str, str]()
        seed = run.seed if source.rates is None else source.rates.catalogue.document.seed
        origin = {"seed": seed, "command": shlex.join(["avrare", *run.provenance.command[1:]])}
        for claim in list_claims(source):
            if (file := claim.file) not in solutions:
                text = file.removeprefix("evidence/")
                solutions[file] = add_element(case, "Sn", text, url=file, sha256=digests[file], **origin)
            goal = add_element(case, "G", claim.text, supported_by=[solutions[file]], measure=claim.measure)
            case[strategy].supported_by.append(goal)
            _challenge_claim(case, goal, claim)
    return case


def _challenge_claim(case: Case, goal: str, claim: Claim) -> None:
    """Add what is known against a claim: warnings, errors, notes, its interval, and unseen failures."""
    doubt, measure, results = partial(add_challenge, case, goal), claim.measure, claim.results
    for file, result in results.items():
        warnings = SceneEstimate(result).warnings if claim.file.endswith(RATES) else result.health
        for name, message in warnings.items():
            is_open = measure.verdict == "inconclusive"
            doubt(f"Warning {name}: {message}", f"{file}#warnings.{name}", is_open)
        if (check := result.cross_check) is not None and check.outcome == "inconclusive":
            doubt(f"The cross-check by {check.estimator} could not decide", f"{file}#cross_check")
        if result.errors:
            text = f"{result.errors:,} of {result.rollouts:,} rollouts broke down"
            doubt(f"{text}; they count against both ends", f"{file}#errors")
        for note in result.notes:
            if note.kind in ("model", "goal"):
                doubt(note.text, f"{file}#notes")
    if measure.verdict in _FAULTS and not case[goal].defeated:
        interval = f"{format_interval((measure.low, measure.high))} {measure.unit}".rstrip()
        fault = f"The interval {interval} {_FAULTS[measure.verdict]} {measure.bound}"
        doubt(fault, f"{claim.file}#interval", True)
    if measure.blind is not None:
        bound = f"{format_probability(measure.blind)} {measure.unit}".rstrip()
        text = f"Failures that the search is not led to could be as likely as {bound}"
        checks = [result.cross_check for result in results.values() if result.blind_bound is not None]
        agreeing = [check.estimator for check in checks if check is not None and check.outcome == "agree"]
        answer = f"A second estimate, by {', '.join(dict.fromkeys(agreeing))}, agrees"
        is_answered, decides = len(agreeing) == len(checks), measure.verdict == "pass_assuming"
        doubt(text, f"{claim.file}#blind_bound", decides, answer if is_answered else "")


def _add_premises(
    case: Case, source: Source, sheets: Mapping[str, Sheet], digests: Mapping[str, str]
) -> Iterator[str]:
    """Add the scenarios with their tags, and the assumptions: laws of drawn options, and exposures."""
    runs = {path: sheet for path, sheet in sheets.items() if sheet["scenario"].startswith(source.home)}
    tags = ("objective", "requirements", "odd")
    scenarios = {
        path: {"file": file, "sha256": digests[file], **{tag: sheet[tag] for tag in tags}}
        for path, sheet in runs.items()
        for file in [sheet["scenario"]]
    }
    names = ", ".join(dict.fromkeys(run.name for run in source.runs.values()))
    context = add_element(case, "C", f"Scenarios: {names}", scenarios=scenarios)
    for doubt in dict.fromkeys(_doubt_scenarios(source)):
        add_challenge(case, context, doubt)
    yield context
    if laws := {path: sheet["inputs"]["laws"] for path, sheet in runs.items() if sheet["inputs"]["laws"]}:
        yield add_element(case, "A", f"{source.name}: starts follow the laws of the drawn options", laws=laws)
    if source.rates is not None:
        scenes = source.rates.catalogue.document.scenes
        exposures = {
            scene.name: {
                **asdict(exposure),
                "unit": scene.unit,
                "stated": scene.exposure and scene.exposure.model_dump(mode="json", exclude_defaults=True),
            }
            for scene, exposure in zip(scenes, source.rates.exposures, strict=True)
        }
        text = f"{source.name}: scenes are met as often as stated"
        assumption = add_element(case, "A", text, exposures=exposures)
        for doubt in chain.from_iterable(map(_doubt_exposure, scenes)):
            add_challenge(case, assumption, doubt)
        yield assumption


def _doubt_scenarios(source: Source) -> Iterator[str]:
    for run in source.runs.values():
        warnings = run.definition.warnings if run.definition is not None else ()
        yield from (message.partition(": ")[2] or message for message, _ in warnings)
        if run.provenance.uncommitted_changes is not False:
            yield "The repository had changes that no commit has: the commit does not identify the files"
    yield from (row.reason for row in source.rows if row.question == "baseline")


def _doubt_exposure(scene: SceneEntry) -> Iterator[str]:
    from scipy.special import chdtri

    subject, exposure = f"Scene {scene.name}", scene.exposure
    if exposure is None:
        yield f"{subject} has no exposure: shares of cells of a grid say nothing on rates of the road"
    elif exposure.counts and sum(exposure.counts):
        scatter, freedom = variance(exposure.counts) / mean(exposure.counts), len(exposure.counts) - 1
        if scatter * freedom > chdtri(freedom, 0.05):
            text = f"its counts scatter {scatter:.2g} times as much as Poisson's"
            yield f"{subject}: {text}: its interval is widened by that, if the blocks are independent"
    elif exposure.count is None and exposure.interval is None:
        yield f"{subject}: its exposure is stated without an interval, and counts as known exactly"
