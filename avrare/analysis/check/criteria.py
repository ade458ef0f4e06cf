"""Criteria of a check, thresholds and regressions, and the verdicts on them (docs/ci.md).

A check fails if any criterion fails, so with many criteria one would fail by chance. Holm's step-down
procedure ("A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6 (1979)) keeps the
chance that any of them does so at that of a single one, whatever their dependence, and never fails less than
Bonferroni. A check passes only if every criterion passes, which errs no more often than one of them does
(Berger 1982), so passing needs no correction.

Several looks share the error rate (Bonferroni over looks).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from avrare.analysis.check.melded_intervals import (
    p_value_ratio_at_least,
    p_value_ratio_at_most,
    ratio_interval,
)
from avrare.base.number_format import format_probability
from avrare.estimation.result.confidence_distributions import derive_distribution
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import (
    Side,
    Verdict,
    decide,
    describe_assumption,
    find_doubts,
    grade_blind,
    is_below,
)
from avrare.scenario.schema import Regression, Threshold


@dataclass(frozen=True)
class Criterion:
    """Condition on the failure probability of one specification."""

    scenario: str
    specification: str
    condition: Threshold | Regression  # bound of the probability, or allowed regression against ``baseline``
    baseline: Result | None = None
    reference: str = "baseline"  # or "first baseline": the first of its line

    @property
    def kind(self) -> str:
        """Either "threshold" or "regression"."""
        return "threshold" if isinstance(self.condition, Threshold) else "regression"

    @property
    def question(self) -> str:
        """Condition in symbols: ``< 0.02``, ``< 0.02 at 0.99``, ``<= baseline``, ``<= 1.5 x baseline``."""
        if isinstance(self.condition, Threshold):
            confidence = self.condition.confidence
            default = confidence == Threshold.model_fields["confidence"].default
            # Two thresholds of one specification need different names: servers keep one test of a name.
            level = "" if default else f" at {confidence:g}"
            counted = ", blind counted" if self.condition.blind == "counted" else ""
            return f"{self.condition.probability}{level}{counted}"
        ratio = self.condition.ratio
        return f"<= {self.reference}" if ratio == 1.0 else f"<= {ratio:g} x {self.reference}"


@dataclass(frozen=True)
class Assessment:
    """Estimate weighed against one criterion."""

    # p-value of "the criterion holds" over the level at which it alone would fail: it fails at a value of at
    # most 1, or less where there are several criteria
    normalised_p_value: float
    passes: bool  # the estimate shows that the criterion holds


def assess(criterion: Criterion, result: Result, share: float) -> Assessment:
    """Weigh a result against a criterion, at a look with this share of the error rate (1: the only one)."""
    distribution = derive_distribution(result)
    condition, baseline = criterion.condition, criterion.baseline
    tail = (1.0 - condition.confidence) / 2.0
    if isinstance(condition, Threshold):
        limit = condition.limit
        _, high = distribution.interval_at(1.0 - share * (1.0 - condition.confidence))
        passes = is_below(high, condition)
        impossible = condition.strict and limit == 0.0
        return Assessment(0.0 if impossible else distribution.p_value_at_most(limit) / tail, passes)
    if baseline is None or baseline.relation != result.relation:
        return Assessment(math.inf, False)
    before = derive_distribution(baseline)
    failing = p_value_ratio_at_most(condition.ratio, distribution, before) / tail
    if result.probability == 0.0 and baseline.probability == 0.0:
        # The ratio of two zeros is undefined: require an upper end as good as the baseline's.
        ends = [law.interval_at(condition.confidence)[1] for law in (distribution, before)]
        return Assessment(failing, ends[0] < 1.0 and ends[0] <= condition.excluded * ends[1])
    passing = p_value_ratio_at_least(condition.excluded, distribution, before)
    return Assessment(failing, passing <= share * tail)


def decide_criteria(
    criteria: Sequence[Criterion],
    results: Callable[[Criterion], Result | None],
    share: float,
    decided: Mapping[int, str],
) -> dict[int, str]:
    """Return the verdict by number of the criterion after one more look; undecided ones are left out.

    Verdicts of earlier looks (``decided``) stay. ``results`` gives the estimate of a specification; ``share``
    is the part of the error rate that this look uses.
    """
    estimates = {
        number: result
        for number, criterion in enumerate(criteria)
        if number not in decided and (result := results(criterion)) is not None
    }
    assessments = {number: assess(criteria[number], result, share) for number, result in estimates.items()}
    doubted = {number: is_in_doubt(criteria[number], result) for number, result in estimates.items()}
    trusted = {number: assessment for number, assessment in assessments.items() if not doubted[number]}
    failing = _find_failing(trusted, share, decided, len(criteria))
    verdicts = dict(decided)
    for number, result in estimates.items():
        criterion = criteria[number]
        side: Side = "above" if number in failing else "below" if assessments[number].passes else "across"
        warned = bool(find_objections(criterion, result))
        verdict = decide(side, warned, doubted[number], _grade_blind(criterion, result))
        if verdict != "inconclusive":
            verdicts[number] = verdict
    return verdicts


def _grade_blind(criterion: Criterion, result: Result) -> Verdict:
    bound = criterion.condition
    return grade_blind(result.blind_bound, bound) if isinstance(bound, Threshold) else "pass"


def _find_failing(
    assessments: Mapping[int, Assessment], share: float, decided: Mapping[int, str], criteria: int
) -> list[int]:
    # Holm's procedure; criteria that passed at an earlier look still count as hypotheses.
    left = criteria - sum(verdict == "fail" for verdict in decided.values())
    failing: list[int] = []
    # 1. From the smallest p-value to the largest ...
    for number in sorted(assessments, key=lambda number: assessments[number].normalised_p_value):
        # 2. ... stop at the first one above the level that its rank allows.
        if assessments[number].normalised_p_value > share / (left - len(failing)):
            break
        failing.append(number)
    return failing


def is_in_doubt(criterion: Criterion, result: Result | None) -> bool:
    """Return whether a warning doubts the estimate or its baseline: the criterion cannot fail either."""
    estimates = [estimate for estimate in (result, criterion.baseline) if estimate is not None]
    return any(find_doubts(estimate.health) for estimate in estimates)


def find_assumption(criterion: Criterion, result: Result) -> str:
    """Return the assumption of a threshold that only unseen failures could break, otherwise ""."""
    if result.blind_bound is None or _grade_blind(criterion, result) == "pass":
        return ""
    return describe_assumption(result.blind_bound) if assess(criterion, result, 1.0).passes else ""


def describe_unknown_change(criterion: Criterion, result: Result) -> str:
    """Return how high the probabilities could be if neither estimate has a failure, otherwise ""."""
    baseline, level = criterion.baseline, criterion.condition.confidence
    if baseline is None or result.probability or baseline.probability:
        return ""
    here, before = (
        format_probability(derive_distribution(estimate).interval_at(level)[1], 2)
        for estimate in (result, baseline)
    )
    return f"no failures: the change is not known, at most {here} here and {before} in the baseline"


def describe_health(result: Result) -> list[str]:
    """Return the warnings of an estimate, each with its name and its cause."""
    return [f"{name}: {text}" for name, text in result.health.items()]


def find_objections(criterion: Criterion, result: Result | None) -> list[str]:
    """Return the reasons why a criterion must not pass, however good its numbers are."""
    objections = describe_health(result) if result is not None else []
    baseline = criterion.baseline
    if baseline is not None and baseline.health:
        objections.append(f"the baseline has health warnings: {', '.join(baseline.health)}")
    if baseline is not None and result is not None and baseline.relation != result.relation:
        objections.append(f"failure is {result.relation} here, {baseline.relation} in the baseline")
    return objections


@dataclass(frozen=True)
class Decision:
    """Verdict on one criterion, with the numbers that it rests on, at the confidence of the criterion."""

    scenario: str
    specification: str
    kind: str
    question: str
    verdict: str
    reason: str  # may be empty
    probability: float | None = None
    interval: Interval | None = None
    baseline: float | None = None  # probability in the baseline
    change: float | None = None  # probability over that of the baseline
    change_interval: Interval | None = None  # infinity: unbounded
    rollouts: int = 0
    seconds: float = 0.0
    next_step: str = ""  # command or number that helps with a failing or inconclusive row

    @property
    def name(self) -> str:
        """Specification and condition; unique within the scenario."""
        return f"{self.specification} {self.question}"


def make_decision(criterion: Criterion, verdict: str, reason: str, result: Result | None) -> Decision:
    """Return the decision on a criterion, with the numbers of its estimate and baseline."""
    names = (criterion.scenario, criterion.specification, criterion.kind, criterion.question)
    baseline = criterion.baseline
    before = baseline.probability if baseline else None
    if result is None:
        return Decision(*names, verdict, reason, baseline=before)
    confidence, distribution = criterion.condition.confidence, derive_distribution(result)
    change = interval = None
    if baseline is not None:
        change = result.probability / before if before else None if not result.probability else math.inf
        interval = ratio_interval(confidence, distribution, derive_distribution(baseline))
    return Decision(
        *names,
        verdict,
        reason,
        result.probability,
        distribution.interval_at(confidence),
        before,
        change,
        interval,
        result.rollouts,
        result.seconds,
    )
