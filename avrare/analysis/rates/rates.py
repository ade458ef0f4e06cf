"""Rates of a catalogue from the estimates of its scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from avrare.analysis.rates.allocation import allocate
from avrare.analysis.rates.catalogue import Catalogue, RateThreshold
from avrare.analysis.rates.combination import FEW, Quantity, Total, combine, from_exposure, from_rollouts
from avrare.base.errors import ExitCode, UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.result import worst_verdict

Counts = Mapping[str, tuple[int, int, int]]
"""Rule -> failures, rollouts and errors of one scene."""


@dataclass(frozen=True)
class Decision:
    """Threshold with its verdict: pass, fail or inconclusive."""

    threshold: RateThreshold
    verdict: str


@dataclass(frozen=True)
class RuleRate:
    """Rate of one rule.

    Attributes:
        rule: Name of the specification.
        totals: By unit, ``hour`` and ``km``, as far as known.
        decisions: Verdicts of its thresholds.
    """

    rule: str
    totals: dict[str, Total]
    decisions: tuple[Decision, ...]


@dataclass(frozen=True)
class CatalogueRates:
    """Rates of all rules of a catalogue.

    Attributes:
        catalogue: What was asked.
        rollouts: Rollouts of each scene that count.
        counts: Failures, rollouts and errors by rule, of each scene.
        exposures: Of each scene, in the unit of its file.
        rates: By rule.
        errors: Scenes with more errors than they allow.
    """

    catalogue: Catalogue
    rollouts: tuple[int, ...]
    counts: tuple[Counts, ...]
    exposures: tuple[Quantity, ...]
    rates: tuple[RuleRate, ...]
    errors: tuple[str, ...] = ()

    @property
    def verdict(self) -> str | None:
        """Gravest verdict; None without thresholds."""
        return worst_verdict(one.verdict for rate in self.rates for one in rate.decisions)

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of ``avrare rate``."""
        if self.errors:
            return ExitCode.ROLLOUT_ERRORS
        codes = {"fail": ExitCode.FAIL, "inconclusive": ExitCode.INCONCLUSIVE}
        return codes.get(self.verdict or "", ExitCode.PASS)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of rate.json."""
        document = self.catalogue.document
        scenes = [
            {"name": entry.name, "scenario": entry.scenario, "exposure": asdict(exposure),
             "unit": entry.exposure.unit, "rollouts": rollouts,
             "failures": {rule: counts[rule][0] for rule in self.catalogue.rules},
             "errors": max(counts[rule][2] for rule in self.catalogue.rules)}
            for entry, exposure, rollouts, counts in zip(
                document.scenes, self.exposures, self.rollouts, self.counts, strict=True)
        ]  # fmt: skip
        rules = [
            {"rule": rate.rule, **{f"per_{unit}": asdict(total) for unit, total in rate.totals.items()},
             "thresholds": [{"bound": one.threshold.text, "verdict": one.verdict} for one in rate.decisions]}
            for rate in self.rates
        ]  # fmt: skip
        return {
            "schema": 1, "catalogue": document.name, "confidence": document.confidence, "seed": document.seed,
            "speed": document.speed, "verdict": self.verdict, "scenes": scenes, "rules": rules,
        }  # fmt: skip


def divide(catalogue: Catalogue, budget: Budget, steps: Sequence[int], pilot: Sequence[Counts]) -> list[int]:
    """Return the rollouts of each scene from its pilot.

    Args:
        catalogue: Scenes, exposures and rules.
        budget: Cost of everything, the pilot included.
        steps: Steps of a rollout of each scene.
        pilot: Counts of each scene's pilot.

    Raises:
        UsageError: The budget is too small.
    """
    costs = [float(count) for count in steps] if budget.kind == "steps" else [1.0] * len(steps)
    spent = catalogue.document.pilot * sum(costs)
    if spent >= budget.amount:
        text = f"the pilot alone costs {spent:,.0f} {budget.kind} of {budget.amount:,.0f}"
        raise UsageError(text, "raise the budget, or lower pilot")
    document = catalogue.document
    rates = [from_exposure(entry.exposure, document.confidence) for entry in document.scenes]
    known = [rate.value or rate.high for rate in rates]  # a scene never met widens the interval as well
    exposures = _in_unit(catalogue, known, "hour") or _in_unit(catalogue, known, "km") or known
    seen = [[scene[rule][:2] for rule in catalogue.rules] for scene in pilot]
    return allocate(exposures, seen, costs, budget.amount - spent)


def compute(catalogue: Catalogue, counts: Sequence[Counts], errors: Sequence[str] = ()) -> CatalogueRates:
    """Return the rates from the counts of each scene."""
    document = catalogue.document
    exposures = [from_exposure(entry.exposure, document.confidence) for entry in document.scenes]
    rates = []
    for rule in catalogue.rules:
        few = sum(scene[rule][0] for scene in counts) < FEW
        parts = [
            from_rollouts(failures, rollouts, wrong, document.confidence, few)
            for failures, rollouts, wrong in (scene[rule] for scene in counts)
        ]
        totals = {}
        for unit in ("hour", "km"):
            values = _in_unit(catalogue, [1.0] * len(exposures), unit)
            if values is not None:
                scaled = [
                    Quantity(*(factor * part for part in (e.value, e.low, e.high)))
                    for e, factor in zip(exposures, values, strict=True)
                ]
                totals[unit] = combine(scaled, parts)
        asked = [one for one in document.thresholds if one.rule == rule]
        decisions = tuple(Decision(one, _decide(totals[one.unit], one)) for one in asked)
        rates.append(RuleRate(rule, totals, decisions))
    rollouts = tuple(max(scene[rule][1] for rule in catalogue.rules) for scene in counts)
    return CatalogueRates(catalogue, rollouts, tuple(counts), tuple(exposures), tuple(rates), tuple(errors))


def _in_unit(catalogue: Catalogue, values: Sequence[float], unit: str) -> list[float] | None:
    # Exposures per hour or per km; None where no speed says how.
    speed, found = catalogue.document.speed, []
    for entry, value in zip(catalogue.document.scenes, values, strict=True):
        if entry.exposure.unit == unit:
            found.append(value)
        elif speed is None:
            return None
        else:
            found.append(value / speed if unit == "km" else value * speed)
    return found


def _decide(total: Total, threshold: RateThreshold) -> str:
    low, high = total.interval
    if high < threshold.limit or (high == threshold.limit and "<=" in threshold.text):
        return "pass"
    return "fail" if low > threshold.limit else "inconclusive"
