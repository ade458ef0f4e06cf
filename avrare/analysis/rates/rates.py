"""Rates of a catalogue from the estimates of its scenes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from avrare.analysis.rates.allocation import allocate
from avrare.analysis.rates.balance import RiskBalance, weigh
from avrare.analysis.rates.catalogue import Catalogue
from avrare.analysis.rates.catalogue_document import RateThreshold
from avrare.analysis.rates.combination import FEW, Quantity, Total, combine, from_scene
from avrare.analysis.rates.scene_estimates import SceneEstimate, SceneEstimates
from avrare.base.errors import ExitCode, UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Answer, Records
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import (
    decide,
    describe_assumption,
    find_side,
    grade_blind,
    worst_verdict,
)

BROKEN = "more rollouts ended in an error than allowed"
_OWN_FIELDS = (
    "rollouts", "estimator", "probability", "interval", "simulated_steps", "relative_error", "blind_bound",
)  # fmt: skip
"""Fields in rate.json of a result that does not follow from counts."""


@dataclass(frozen=True)
class Decision:
    """Threshold with its verdict (``estimation.result.verdict``).

    Attributes:
        threshold: The bound.
        verdict: The verdict.
        reasons: Warned estimates that keep the verdict from being another, as ``scene: warning``, or the
            assumption of a ``pass_assuming``.
    """

    threshold: RateThreshold
    verdict: str
    reasons: tuple[str, ...] = ()

    @property
    def explanation(self) -> str:
        """Reasons in brackets after a space; empty where there are none."""
        return f" ({', '.join(self.reasons)})" if self.reasons else ""


@dataclass(frozen=True)
class RuleRate:
    """Rate of one rule.

    Attributes:
        rule: Name of the specification.
        totals: By unit, ``hour``, ``km`` and ``cell``, as far as known.
        decisions: Verdicts of its thresholds.
        blind: By unit, upper bound for failures that the scenes' own estimators do not lead to; empty where
            each rollout is drawn from its scene's law.
    """

    rule: str
    totals: dict[str, Total]
    decisions: tuple[Decision, ...]
    blind: dict[str, float]


@dataclass(frozen=True, repr=False)
class CatalogueRates(Answer):
    """Rates of all rules of a catalogue.

    Attributes:
        catalogue: The question: scenes, rules and bounds.
        rollouts: Rollouts of each scene: the shared ones that count, and the whole cost of its own estimator.
        estimates: Of each scene.
        exposures: Of each scene, in the unit of its file.
        rates: By rule.
        errors: Scenes with more errors than they allow.
        folder: Folder of the results; None where nothing was written.
        driver: The controller that drove the same scenes in place of the stack's; empty: none did.
        reference: Its rates.
    """

    catalogue: Catalogue
    rollouts: tuple[int, ...]
    estimates: tuple[SceneEstimates, ...]
    exposures: tuple[Quantity, ...]
    rates: tuple[RuleRate, ...]
    errors: tuple[str, ...] = ()
    folder: Path | None = None
    driver: str = ""
    reference: CatalogueRates | None = None

    def table(self) -> Records:
        """Return one row for each rule and unit."""
        return Records(
            {
                "rule": rate.rule,
                "unit": unit,
                "rate": total.value,
                "low": total.interval[0],
                "high": total.interval[1],
                "verdict": worst_verdict(
                    decision.verdict for decision in rate.decisions if decision.threshold.unit == unit
                ),
            }
            for rate in self.rates
            for unit, total in rate.totals.items()
        )

    def lines(self) -> list[str]:
        """Return the rates with their intervals, and the verdicts."""
        lines = [
            f"{rate.rule}: {format_probability(total.value)} ({format_interval(total.interval)}) per {unit}"
            for rate in self.rates
            for unit, total in rate.totals.items()
        ]
        lines += [
            f"{rate.rule} {decision.threshold.text}: {decision.verdict}{decision.explanation}"
            for rate in self.rates
            for decision in rate.decisions
        ]
        lines += [balance.describe(self.driver) for balance in self.balances]
        return [*lines, *([f"{BROKEN}: {', '.join(self.errors)}"] if self.errors else [])]

    @property
    def balances(self) -> list[RiskBalance]:
        """Each rule's rate beside that of the other driver; empty without one."""
        if self.reference is None:
            return []
        return [
            weigh(
                rate.rule,
                next(iter(rate.totals)),
                self.exposures,
                self._terms(rate),
                self.reference._terms(other),
            )
            for rate, other in zip(self.rates, self.reference.rates, strict=True)
        ]

    def _terms(self, rate: RuleRate) -> tuple[Total, list[Result]]:
        total = next(iter(rate.totals.values()))
        return total, [scene[rate.rule].result for scene in self.estimates]

    @property
    def own(self) -> Iterator[tuple[str, str, SceneEstimate]]:
        """Estimates that do not follow from counts, each with the names of its scene and rule."""
        for entry, estimates in zip(self.catalogue.document.scenes, self.estimates, strict=True):
            for rule, estimate in estimates.items():
                if not estimate.follows_counts:
                    yield entry.name, rule, estimate

    @property
    def verdict(self) -> str | None:
        """Gravest verdict; None without thresholds."""
        return worst_verdict(decision.verdict for rate in self.rates for decision in rate.decisions)

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of ``avrare rate``."""
        if self.errors:
            return ExitCode.ROLLOUT_ERRORS
        codes = {"fail": ExitCode.FAIL, "inconclusive": ExitCode.INCONCLUSIVE}
        return codes.get(self.verdict or "", ExitCode.PASS)

    def to_dict(self) -> dict[str, object]:
        """Return the content of rate.json."""
        document = self.catalogue.document
        rows = zip(document.scenes, self.exposures, self.rollouts, self.estimates, strict=True)
        scenes = [
            {
                "name": entry.name,
                "scenario": entry.scenario,
                "exposure": asdict(exposure),
                "unit": entry.unit,
                "rollouts": rollouts,
                "failures": {
                    rule: estimate.result.failures.count
                    for rule, estimate in estimates.items()
                    if estimate.follows_counts
                },
                "errors": max(estimate.result.errors for estimate in estimates.values()),
                **_own_entries(estimates),
            }
            for entry, exposure, rollouts, estimates in rows
        ]
        reference = {} if self.reference is None else self.reference.to_dict()
        compared = {
            "driver": self.driver,
            "balances": [balance.to_dict() for balance in self.balances],
            **{key: reference.get(key) for key in ("scenes", "rules")},
        }
        return {
            "schema": 1,
            "catalogue": document.name,
            "confidence": document.confidence,
            "seed": document.seed,
            "speed": document.speed,
            "verdict": self.verdict,
            "document": document.model_dump(mode="json", exclude_defaults=True),
            "scenes": scenes,
            "rules": [_rule_entry(rate) for rate in self.rates],
            **({"reference": compared} if reference else {}),
        }


def _own_entries(estimates: SceneEstimates) -> dict[str, object]:
    fields = {
        rule: {name: estimate.result.to_dict()[name] for name in _OWN_FIELDS}
        for rule, estimate in estimates.items()
        if not estimate.follows_counts
    }
    warnings = {rule: estimate.warnings for rule, estimate in estimates.items() if estimate.warnings}
    return ({"estimates": fields} if fields else {}) | ({"warnings": warnings} if warnings else {})


def _rule_entry(rate: RuleRate) -> dict[str, object]:
    totals = {f"per_{unit}": asdict(total) for unit, total in rate.totals.items()}
    blind = {f"blind_bound_per_{unit}": bound for unit, bound in rate.blind.items()}
    thresholds = [
        {"bound": decision.threshold.text, "verdict": decision.verdict}
        | ({"reasons": list(decision.reasons)} if decision.reasons else {})
        for decision in rate.decisions
    ]
    return {"rule": rate.rule, **totals, **blind, "thresholds": thresholds}


def divide(
    catalogue: Catalogue,
    budget: Budget,
    steps: Sequence[int],
    pilot: Sequence[SceneEstimates],
    separate: Sequence[SceneEstimates] = (),
) -> list[int]:
    """Return the rollouts of each scene from its pilot; 0 where its own estimators cover all rules.

    Args:
        catalogue: Scenes, exposures and rules.
        budget: Cost of everything, the pilot and the budgets of scenes included.
        steps: Steps of a rollout of each scene.
        pilot: Pilot estimates of each scene, by rule that shares the budget.
        separate: Estimates of scenes by their own estimators, if known.

    Raises:
        UsageError: The budget is too small.
    """
    costs = [float(count) for count in steps] if budget.kind == "steps" else [1.0] * len(steps)
    sharing = [index for index in range(len(steps)) if catalogue.list_shared_rules(index)]
    fixed = catalogue.own_estimators_cost(budget.kind, steps)
    pilot_cost = catalogue.document.pilot * sum(costs[index] for index in sharing) + fixed
    if pilot_cost >= budget.amount:
        cost = "the pilot alone costs" if not fixed else "the pilot and the scenes' own budgets cost"
        text = f"{cost} {pilot_cost:,.0f} {budget.kind} of {budget.amount:,.0f}"
        raise UsageError(text, "raise the budget, or lower pilot")
    document = catalogue.document
    rates = [from_scene(entry, document.confidence) for entry in document.scenes]
    expected = [rate.value or rate.high for rate in rates]  # a scene never met widens the interval as well
    exposures = _in_unit(catalogue, expected, "hour") or _in_unit(catalogue, expected, "km") or expected
    pilot_counts = [[_counts(pilot[index].get(rule)) for rule in catalogue.rules] for index in sharing]
    others = [
        math.fsum(
            e * _own_probability(scene.get(rule)) for e, scene in zip(exposures, separate, strict=False)
        )
        for rule in catalogue.rules
    ]
    chosen = allocate(
        [exposures[index] for index in sharing],
        pilot_counts,
        [costs[index] for index in sharing],
        budget.amount - pilot_cost,
        others,
    )
    rollouts = dict(zip(sharing, chosen, strict=True))
    return [rollouts.get(index, 0) for index in range(len(steps))]


def _counts(estimate: SceneEstimate | None) -> tuple[int, int] | None:
    return None if estimate is None else (estimate.result.failures.count, estimate.result.rollouts)


def _own_probability(estimate: SceneEstimate | None) -> float:
    return estimate.result.probability if estimate is not None and not estimate.follows_counts else 0.0


def compute(
    catalogue: Catalogue, estimates: Sequence[SceneEstimates], errors: Sequence[str] = ()
) -> CatalogueRates:
    """Return the rates from the estimates of each scene."""
    document = catalogue.document
    exposures = [from_scene(entry, document.confidence) for entry in document.scenes]
    rates = tuple(_rule_rate(catalogue, rule, exposures, estimates) for rule in catalogue.rules)
    rollouts = tuple(
        max((estimate.result.rollouts for estimate in scene.values() if not estimate.cost), default=0)
        + sum(estimate.cost for estimate in scene.values())
        for scene in estimates
    )
    return CatalogueRates(catalogue, rollouts, tuple(estimates), tuple(exposures), rates, tuple(errors))


def _rule_rate(
    catalogue: Catalogue, rule: str, exposures: Sequence[Quantity], estimates: Sequence[SceneEstimates]
) -> RuleRate:
    document, results = catalogue.document, [scene[rule] for scene in estimates]
    few = sum(estimate.result.failures.count for estimate in results if estimate.follows_counts) < FEW
    parts = [estimate.quantity(document.confidence, few) for estimate in results]
    bounds = [None if estimate.follows_counts else estimate.result.blind_bound for estimate in results]
    totals, blind = {}, {}
    for unit in ("hour", "km", "cell"):
        values = _in_unit(catalogue, [1.0] * len(exposures), unit)
        if values is None:
            continue
        scaled = [
            Quantity(*(factor * part for part in (e.value, e.low, e.high)))
            for e, factor in zip(exposures, values, strict=True)
        ]
        totals[unit] = combine(scaled, parts)
        if any(bound is not None for bound in bounds):
            blind[unit] = math.fsum(e.high * (bound or 0.0) for e, bound in zip(scaled, bounds, strict=True))
    names = [entry.name for entry in document.scenes]
    thresholds = [threshold for threshold in document.thresholds if threshold.rule == rule]
    scenes = dict(zip(names, results, strict=True))
    decisions = tuple(
        _decide(totals[threshold.unit], blind.get(threshold.unit), threshold, scenes)
        for threshold in thresholds
    )
    return RuleRate(rule, totals, decisions, blind)


def _in_unit(catalogue: Catalogue, values: Sequence[float], unit: str) -> list[float] | None:
    # Exposures per hour or per km, or shares of cells; None where no speed says how.
    speed, converted = catalogue.document.speed, []
    cells = math.fsum(entry.cells or 0 for entry in catalogue.document.scenes)
    for entry, value in zip(catalogue.document.scenes, values, strict=True):
        if entry.unit == unit:
            converted.append(value / cells if unit == "cell" else value)
        elif speed is None or "cell" in (unit, entry.unit):
            return None
        else:
            converted.append(value / speed if unit == "km" else value * speed)
    return converted


def _decide(
    total: Total, blind_bound: float | None, threshold: RateThreshold, scenes: dict[str, SceneEstimate]
) -> Decision:
    side, best = find_side(total.interval, threshold), grade_blind(blind_bound, threshold)
    warned = tuple(f"{name}: {text}" for name, scene in scenes.items() for text in scene.warnings)
    doubted = tuple(f"{name}: {text}" for name, scene in scenes.items() for text in sorted(scene.doubts))
    verdict = decide(side, bool(warned), bool(doubted), best)
    reasons = {"below": warned, "above": doubted, "across": ()}[side]
    if side == "below" and not warned and blind_bound is not None and best != "pass":
        reasons = (describe_assumption(blind_bound),)
    return Decision(threshold, verdict, reasons)
