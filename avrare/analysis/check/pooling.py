"""Pooling of independent batches of the same estimate, as ``--spend`` draws them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.analysis.check.confidence_distributions import (
    Binomial,
    ConfidenceDistribution,
    LogNormal,
    derive_distribution,
)
from avrare.estimation import health
from avrare.estimation.intervals import cox
from avrare.estimation.result import Failures, Result

_SYSTEM_WARNINGS = ("not_deterministic",)
"""Warnings about the system, which stay whatever a later batch shows."""


@dataclass(frozen=True)
class _PooledMean:
    mean: float
    relative_variance: float
    distribution: ConfidenceDistribution


def pool(batches: Sequence[Result], max_error_rate: float) -> Result:
    """Return all batches, in the order in which they were drawn, as one estimate.

    Monte Carlo adds up its counts; splitting puts its runs together; single weighted runs are averaged by
    their rollouts. Where none of that is possible, the newest batch, as large as all others together, stands
    alone. Health is that of the newest batch, except for errors, which are counted over all batches, and for
    a system that is not deterministic.
    """
    newest = batches[-1]
    if len(batches) == 1:
        return newest
    # 1. Add up the costs, failures and errors.
    names = ("rollouts", "simulated_steps", "errors", "seconds")
    changes: dict[str, Any] = {name: sum(getattr(batch, name) for batch in batches) for name in names}
    count = sum(batch.failures.count for batch in batches)
    changes["failures"] = Failures(newest.failures.noise, newest.failures.robustness, count)
    worst = [batch.worst for batch in batches if not math.isnan(batch.worst.robustness)]
    changes["worst"] = min(worst, key=lambda one: one.robustness, default=newest.worst)
    # 2. Derive the health warnings.
    warnings = {name: text for name, text in newest.health.items() if name != "errors"}
    messages = [batch.health["errors"] for batch in batches if "errors" in batch.health]
    for batch in batches:
        warnings |= {name: text for name, text in batch.health.items() if name in _SYSTEM_WARNINGS}
    warnings |= health.check_errors(changes["errors"], changes["rollouts"], max_error_rate, messages)
    # 3. Pool the means by the first method that fits their laws.
    pooled = _pool_counts(batches) or _pool_runs(batches) or _pool_weighted(batches)
    if pooled is not None:
        changes |= {
            "probability": pooled.mean,
            "relative_error": math.sqrt(pooled.relative_variance),
            "interval_at": pooled.distribution.interval_at,
            "run_probabilities": np.concatenate([batch.run_probabilities for batch in batches]),
        }
    return replace(newest, health=warnings, **changes)


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
    known = all(isinstance(law, (Binomial, LogNormal)) or not part.any() for law, part in pairs)
    values = np.concatenate(parts)
    if not known or min(map(len, parts)) < 2 or not values.any():
        return None
    mean = float(values.mean())
    least = min(law.relative_variance for law, _ in pairs if isinstance(law, LogNormal)) / len(batches)
    relative = float((values / mean).var(ddof=1)) / len(values) or least
    undecided = sum(law.undecided * len(part) for law, part in pairs if isinstance(law, LogNormal))
    law = LogNormal(mean, relative, len(values) - 1, undecided / len(values), cox(values))
    return _PooledMean(mean, relative, law)


def _pool_weighted(batches: Sequence[Result]) -> _PooledMean | None:
    # Single runs are averaged by their share of the rollouts, which was planned and does not bias the mean.
    laws = [law for batch in batches if isinstance(law := derive_distribution(batch), LogNormal)]
    if len(laws) < len(batches):
        return None
    shares = [batch.rollouts / sum(other.rollouts for other in batches) for batch in batches]
    pairs = list(zip(shares, laws, strict=True))
    mean = sum(share * law.mean for share, law in pairs)
    relative = sum((share * law.mean / mean) ** 2 * law.relative_variance for share, law in pairs)
    freedom = sum(law.freedom for law in laws)
    undecided = sum(share * law.undecided for share, law in pairs)
    return _PooledMean(mean, relative, LogNormal(mean, relative, freedom, undecided))
