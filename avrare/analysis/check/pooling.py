"""Pooling of independent batches of the same estimate, as ``--looks`` draws them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np

from avrare.estimation.result import health, intervals
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    ConfidenceDistribution,
    LogNormal,
    derive_distribution,
)
from avrare.estimation.result.doubts import undo_opening
from avrare.estimation.result.intervals import cox
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import CrossCheckResult, Failures, Result

SHARES = (0.125, 0.125, 0.25, 0.5)
"""Share of the budget and of the error rate that each look uses; each from the second doubles the total."""


@dataclass(frozen=True)
class _PooledMean:
    mean: float
    relative_variance: float
    distribution: ConfidenceDistribution


def pool(batches: Sequence[Result], max_error_rate: float) -> Result:
    """Return all batches, in the order in which they were drawn, as one estimate.

    Monte Carlo adds up its counts; splitting puts its runs together; single weighted runs are averaged by
    their shares of the budget. Where none of that is possible, the newest batch, as large as all others
    together, stands alone. The warnings of all batches count, and so do the intervals that they opened: a
    later batch that has none may just have missed the tail. So does a cross-check that disagrees. Only a
    batch whose sole warning is that it is unchecked gives way to a newest one that is checked and agrees.
    Errors are counted over all batches. Other notes are the newest batch's, except for that on its goal.
    """
    newest = batches[-1]
    if len(batches) == 1:
        return newest
    # 1. Add up the costs, failures and errors.
    names = ("rollouts", "simulated_steps", "errors", "seconds")
    changes: dict[str, Any] = {name: sum(getattr(batch, name) for batch in batches) for name in names}
    trials = [batch.trials for batch in batches]
    changes["trials"] = sum(trials) if all(trials) else 0
    count = sum(batch.failures.count for batch in batches)
    changes["failures"] = Failures(newest.failures.noise, newest.failures.robustness, count)
    worst = [batch.worst for batch in batches if not math.isnan(batch.worst.robustness)]
    changes["cross_check"], checks = _pool_checks(batches)
    # these speak of a single batch
    notes = [note for note in newest.notes if note.kind not in ("goal", "cross_check")]
    changes["notes"] = (*notes, *checks)
    changes["worst"] = min(worst, key=lambda interval: interval.robustness, default=newest.worst)
    # 2. Pool the means by the first method that fits their laws.
    if "unchecked" not in newest.health:
        batches = [batch for batch in batches if not _gives_way(batch, newest)]
    plain = [undo_opening(batch) for batch in batches]
    runs = _pool_runs(plain)
    pooled = _pool_counts(plain) or runs or _pool_by_planned_shares(plain)
    # 3. Collect the health warnings.
    messages = [batch.health["errors"] for batch in batches if "errors" in batch.health]
    solved = ("errors", "single_run") if runs else ("errors",)  # there are several runs now
    warnings = {k: text for batch in batches for k, text in batch.health.items() if k not in solved}
    warnings |= health.check_errors(changes["errors"], changes["rollouts"], max_error_rate, messages)
    if pooled is not None:
        changes |= {
            "probability": pooled.mean,
            "relative_error": math.sqrt(pooled.relative_variance),
            "interval_at": pooled.distribution.interval_at,
            "run_probabilities": np.concatenate([batch.run_probabilities for batch in batches]),
        }
    doubted = [batch.interval_at for batch in batches if batch.unopened_at]
    changes["interval_at"] = reduce(
        lambda interval, other: partial(intervals.hull, interval, other),
        doubted,
        changes.get("interval_at", newest.interval_at),
    )
    return replace(newest, health=warnings, **changes)


def _gives_way(batch: Result, newest: Result) -> bool:
    (low, high), (newest_low, newest_high) = undo_opening(batch).interval, newest.interval
    agrees = low <= newest_high and newest_low <= high
    return batch.health.keys() == {"unchecked"} and agrees


def _pool_checks(batches: Sequence[Result]) -> tuple[CrossCheckResult | None, list[Note]]:
    # The gravest outcome, of equal ones the newest, with its note, at the cost of all.
    checked = [(batch.cross_check, batch.notes) for batch in batches if batch.cross_check]
    if not checked:
        return None, []
    outcomes = ("disagree", "agree", "inconclusive")
    gravest, notes = min(
        reversed(checked), key=lambda pair: (outcomes.index(pair[0].outcome), pair[0].result is None)
    )
    results = [check.result for check, _ in checked if check.result is not None]
    names = ("rollouts", "simulated_steps", "seconds")
    costs: dict[str, Any] = {name: sum(getattr(result, name) for result in results) for name in names}
    whole = gravest.result and replace(gravest.result, **costs)
    return replace(gravest, result=whole), [note for note in notes if note.kind == "cross_check"]


def _pool_counts(batches: Sequence[Result]) -> _PooledMean | None:
    counts = [law for batch in batches if isinstance(law := derive_distribution(batch), Binomial)]
    if len(counts) < len(batches):
        return None
    failures, trials = sum(law.failures for law in counts), sum(law.trials for law in counts)
    p = failures / trials
    relative = (1.0 - p) / (p * trials) if failures else math.nan
    return _PooledMean(p, relative, Binomial(failures, trials, sum(law.undecided for law in counts)))


def _pool_runs(batches: Sequence[Result]) -> _PooledMean | None:
    # The runs of all batches count as runs of one estimate; one that died out is 0 among them.
    parts = [batch.run_probabilities for batch in batches]
    pairs = [(derive_distribution(batch), batch.run_probabilities) for batch in batches]
    poolable = all(isinstance(law, (Binomial, LogNormal)) or not part.any() for law, part in pairs)
    values = np.concatenate(parts)
    several = all(len(batch.run_probabilities) > 1 or "single_run" in batch.health for batch in batches)
    if not (poolable and several and values.any()):
        return None
    mean = float(values.mean())
    least = min(law.relative_variance for law, _ in pairs if isinstance(law, LogNormal)) / len(batches)
    relative = float((values / mean).var(ddof=1)) / len(values) or least
    undecided = sum(law.undecided * len(part) for law, part in pairs if isinstance(law, LogNormal))
    law = LogNormal(mean, relative, len(values) - 1, undecided / len(values), cox(values))
    return _PooledMean(mean, relative, law)


def _pool_by_planned_shares(batches: Sequence[Result]) -> _PooledMean | None:
    # Single runs are averaged by what was planned: rollouts that depend on the outcome would bias the mean.
    laws = [law for batch in batches if isinstance(law := derive_distribution(batch), LogNormal)]
    if len(laws) < len(batches):
        return None
    planned = SHARES[: len(batches)]
    pairs = [(share / sum(planned), law) for share, law in zip(planned, laws, strict=True)]
    mean = sum(share * law.mean for share, law in pairs)
    relative = sum((share * law.mean / mean) ** 2 * law.relative_variance for share, law in pairs)
    freedom = sum(law.freedom for law in laws)
    undecided = sum(share * law.undecided for share, law in pairs)
    return _PooledMean(mean, relative, LogNormal(mean, relative, freedom, undecided))
