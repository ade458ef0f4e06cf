"""What a verdict will cost, from what an earlier estimate cost and how exact it was.

The relative variance of an estimate times its rollouts does not depend on their number: from it follows how
many rollouts leave an error small enough for a verdict, with a chance of 90 % to come to one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

from avrare.check.baseline import Entry
from avrare.check.claims import Claim
from avrare.check.evidence import Binomial, InverseBinomial
from avrare.estimation.intervals import beta_cdf
from avrare.scenario.schema import Regression, Threshold

POWER = 0.9
PRECISION = 0.2
"""Half a relative interval: what is told where nothing is claimed."""
_MOST_FAILURES = 200
_ANY_PRECISION = "+-20 %"


@dataclass(frozen=True)
class Estimate:
    """What one verdict costs.

    Attributes:
        scenario: Name of the scenario.
        specification: Name of the rule.
        question: What is asked.
        rollouts: Needed for it; None where nobody can tell.
        steps: Simulated.
        seconds: With one worker, as fast as the earlier estimate.
        reason: Where the numbers come from, or why there are none.
    """

    scenario: str
    specification: str
    question: str
    rollouts: int | None
    steps: int
    seconds: float
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


def plan(
    scenario: str, claims: Sequence[Claim], known: Mapping[str, Entry], source: str, confidence: float
) -> list[Estimate]:
    """What the claims of a scenario cost, and +-20 % of each rule.

    Args:
        scenario: Its name.
        claims: Its thresholds and comparisons.
        known: Rule -> an earlier estimate.
        source: What the earlier estimates are, in words.
        confidence: Of the intervals that are to be +-20 %.
    """
    found = []
    for claim in claims:
        if claim.specification in known:
            needed = _for_claim(claim, known[claim.specification], len(claims))
            found.append(_priced(scenario, claim.question, known[claim.specification], *needed, source))
    for entry in known.values():
        found.append(_priced(scenario, _ANY_PRECISION, entry, *_for_precision(entry, confidence), source))
    return found


def _priced(
    scenario: str, question: str, entry: Entry, rollouts: float | None, reason: str, source: str
) -> Estimate:
    if rollouts is None:
        return Estimate(scenario, entry.specification, question, None, 0, 0.0, reason)
    # Two digits: it is no more exact than that.
    digits = max(0, math.floor(math.log10(rollouts)) - 1)
    needed = math.ceil(rollouts / 10**digits) * 10**digits
    share = needed / entry.rollouts
    text = f"{reason}, by {source}" if reason else f"by {source}"
    steps = round(entry.simulated_steps * share)
    return Estimate(scenario, entry.specification, question, needed, steps, entry.seconds * share, text)


def _for_precision(entry: Entry, confidence: float) -> tuple[float | None, str]:
    if not _known(entry):
        return None, f"nothing failed in {entry.rollouts:,} simulations: it may need any number"
    return _work(entry) * (_z(1.0 - (1.0 - confidence) / 2.0) / math.log1p(PRECISION)) ** 2, ""


def _for_claim(claim: Claim, entry: Entry, many: int) -> tuple[float | None, str]:
    tail = (1.0 - claim.criterion.confidence) / 2.0
    if isinstance(claim.criterion, Threshold):
        return _for_threshold(claim.criterion, entry, tail, many)
    return _for_regression(claim.criterion, entry, claim.baseline, tail / many)


def _for_threshold(threshold: Threshold, entry: Entry, tail: float, many: int) -> tuple[float | None, str]:
    """Rollouts until the interval leaves the bound out."""
    limit, p = threshold.limit, entry.probability
    if p == limit or limit in (0.0, 1.0) or p == 1.0:
        return None, "the estimate or the bound is at an end: no number of simulations may tell"
    fails = p > limit
    reason = "it is going to fail" if fails else "" if p > 0.0 else "if nothing fails"
    if isinstance(entry.evidence, (Binomial, InverseBinomial)):
        exact = _to_fail(p, limit, tail / many) if fails else _to_pass(p, limit, tail)
        if exact is not None:
            return exact, reason
    if not _known(entry):
        return None, f"nothing failed in {entry.rollouts:,} simulations: it may need any number"
    level = tail / many if fails else tail
    return _work(entry) * ((_z(1.0 - level) + _z(POWER)) / math.log(limit / p)) ** 2, reason


def _to_pass(p: float, limit: float, tail: float) -> int | None:
    """Monte Carlo rollouts that prove the bound in 90 of 100 cases; None beyond 200 failures."""
    for failures in range(_MOST_FAILURES):
        # Where nothing fails the interval is one-sided.
        level = 2.0 * tail if failures == 0 else tail

        def proven(trials: int, failures: int = failures, level: float = level) -> bool:
            return beta_cdf(1.0 - limit, trials - failures, failures + 1) <= level

        rollouts = _first(proven, failures + 1)
        if beta_cdf(1.0 - p, rollouts - failures, failures + 1) >= POWER:
            return rollouts
    return None


def _to_fail(p: float, limit: float, tail: float) -> int | None:
    """Monte Carlo rollouts that refute the bound in 90 of 100 cases; None beyond 200 failures."""
    for failures in range(1, _MOST_FAILURES):

        def likely(trials: int, failures: int = failures) -> bool:
            return beta_cdf(limit, failures, trials - failures + 1) > tail

        rollouts = _first(likely, failures) - 1  # the most of which so many failures are too many
        if rollouts >= failures and beta_cdf(p, failures, rollouts - failures + 1) >= POWER:
            return rollouts
    return None


def _first(holds: Callable[[int], bool], start: int) -> int:
    """The first number from ``start`` for which ``holds``; it does so for all that follow."""
    low, high = start - 1, start
    while not holds(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _for_regression(
    criterion: Regression, entry: Entry, baseline: Entry | None, tail: float
) -> tuple[float | None, str]:
    """Rollouts until the larger ratio is told from the smaller; without a baseline, also for that."""
    if not (_known(entry) and (baseline is None or _known(baseline))):
        return None, "nothing has failed: no ratio can be told; use a threshold"
    ratio = criterion.excluded / criterion.ratio
    allowed = (math.log(ratio) / (_z(1.0 - tail) + _z(POWER))) ** 2
    if baseline is None:
        return 2.0 * _work(entry) / allowed, f"for the baseline and each check, to see a factor of {ratio:g}"
    left = allowed - baseline.relative_error**2
    if left <= 0.1 * allowed:
        needed = math.ceil(2.0 * _work(baseline) / allowed)
        return (
            None,
            f"the baseline is too coarse: it takes {needed:,} simulations, and as many for each check",
        )
    return _work(entry) / left, f"to see a factor of {ratio:g}"


def _known(entry: Entry) -> bool:
    return entry.probability > 0.0 and math.isfinite(entry.relative_error)


def _work(entry: Entry) -> float:
    """Relative variance times rollouts."""
    return entry.relative_error**2 * entry.rollouts


def _z(level: float) -> float:
    return NormalDist().inv_cdf(level)
