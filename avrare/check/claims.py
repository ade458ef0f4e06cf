"""What is decided: thresholds and comparisons with a baseline, one row each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from avrare.check.baseline import Entry
from avrare.check.evidence import evidence_of
from avrare.check.melding import less_than, more_than, ratio_interval
from avrare.estimation.intervals import Interval
from avrare.estimation.result import Result, finite
from avrare.scenario.schema import Regression, Threshold


@dataclass(frozen=True)
class Claim:
    """One thing to decide.

    Attributes:
        scenario: Name of the scenario.
        specification: Name of the rule.
        criterion: A bound of the probability, or how it is compared with ``baseline``.
        baseline: What the rule was found to be before; None for a threshold.
    """

    scenario: str
    specification: str
    criterion: Threshold | Regression
    baseline: Entry | None = None

    @property
    def kind(self) -> str:
        """Either "threshold" or "regression"."""
        return "threshold" if isinstance(self.criterion, Threshold) else "regression"

    @property
    def question(self) -> str:
        """In symbols: ``< 0.02``, ``< 0.02 at 0.99``, ``<= baseline``, ``<= 1.5 x baseline``."""
        if isinstance(self.criterion, Threshold):
            confidence = self.criterion.confidence
            usual = confidence == Threshold.model_fields["confidence"].default
            # Else two thresholds of one rule would share a name, and servers keep one test of a name.
            return str(self.criterion.probability) + ("" if usual else f" at {confidence:g}")
        ratio = self.criterion.ratio
        return "<= baseline" if ratio == 1.0 else f"<= {ratio:g} x baseline"


@dataclass(frozen=True)
class Look:
    """What an estimate says of a claim.

    Attributes:
        blame: p-value of "all is well" over the level at which the claim alone would fail: it fails if that
            is at most 1, or less where there are several claims.
        passes: Whether the claim is shown to hold.
    """

    blame: float
    passes: bool


def look(claim: Claim, result: Result, share: float) -> Look:
    """Weigh a result.

    Args:
        claim: What is asked.
        result: The estimate of its rule.
        share: Of the error rate, that this look may spend; 1 where there is no other.
    """
    evidence = evidence_of(result)
    criterion, baseline = claim.criterion, claim.baseline
    tail = (1.0 - criterion.confidence) / 2.0
    if isinstance(criterion, Threshold):
        limit = criterion.limit
        _, high = evidence.interval_at(1.0 - share * (1.0 - criterion.confidence))
        passes = high < limit or (high == limit and not criterion.strict)
        impossible = criterion.strict and limit == 0.0
        return Look(0.0 if impossible else evidence.above(limit) / tail, passes)
    if baseline is None or baseline.relation != result.relation:
        return Look(math.inf, False)
    blame = more_than(criterion.ratio, evidence, baseline.evidence) / tail
    if result.probability == 0.0 and baseline.probability == 0.0:
        # A ratio of two zeros says nothing: as well bounded as it was is all that can be asked.
        ends = [one.interval_at(criterion.confidence)[1] for one in (evidence, baseline.evidence)]
        return Look(blame, ends[0] < 1.0 and ends[0] <= criterion.excluded * ends[1])
    return Look(blame, less_than(criterion.excluded, evidence, baseline.evidence) <= share * tail)


@dataclass(frozen=True)
class Row:
    """What was decided.

    Attributes:
        scenario: Name of the scenario.
        specification: Name of the rule.
        kind: "threshold" or "regression".
        question: In symbols.
        verdict: "pass", "fail" or "inconclusive".
        reason: Why.
        probability: The estimate, None where there is none.
        interval: At the claim's confidence.
        baseline: The probability that it is compared with.
        change: Probability over baseline, None without one.
        change_interval: Where the ratio of the two lies, at the claim's confidence; infinity: no end.
        rollouts: That the estimate rests on.
        seconds: That they took.
    """

    scenario: str
    specification: str
    kind: str
    question: str
    verdict: str
    reason: str
    probability: float | None = None
    interval: Interval | None = None
    baseline: float | None = None
    change: float | None = None
    change_interval: Interval | None = None
    rollouts: int = 0
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Rule and question, unlike those of all other rows of its scenario."""
        return f"{self.specification} {self.question}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; infinities become null."""
        return dict(finite(dict(vars(self))))


def row(claim: Claim, verdict: str, reason: str, result: Result | None) -> Row:
    """The row of a claim, with the numbers that the verdict rests on."""
    names = (claim.scenario, claim.specification, claim.kind, claim.question)
    if result is None:
        return Row(*names, verdict, reason, baseline=claim.baseline.probability if claim.baseline else None)
    confidence, evidence = claim.criterion.confidence, evidence_of(result)
    change = interval = None
    if claim.baseline is not None:
        before = claim.baseline.probability
        change = result.probability / before if before else None if not result.probability else math.inf
        interval = ratio_interval(confidence, evidence, claim.baseline.evidence)
    return Row(
        *names, verdict, reason, result.probability, evidence.interval_at(confidence),
        claim.baseline.probability if claim.baseline else None, change, interval,
        result.rollouts, result.seconds,
    )  # fmt: skip
