"""One result of several independent batches of the same estimate, as ``--spend`` draws them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.check.evidence import Binomial, Evidence, LogNormal, evidence_of
from avrare.estimation import health
from avrare.estimation.result import Failures, Result

_LASTING = ("not_deterministic",)
"""Warnings of the system, not of a batch."""


@dataclass(frozen=True)
class _Whole:
    """What several batches say together."""

    mean: float
    relative_variance: float
    evidence: Evidence


def pooled(batches: Sequence[Result], max_error_rate: float) -> Result:
    """All batches as one estimate.

    Monte Carlo adds up its counts; splitting puts its runs together; single weighted runs are averaged by
    their rollouts. Where none of that is possible the newest batch, as large as all others together, speaks
    alone. Health is that of the newest, but for the errors, which are counted over all, and for a system
    that was found not to be deterministic.

    Args:
        batches: In the order they were drawn, at least one.
        max_error_rate: Share of broken rollouts above which the whole is unhealthy.
    """
    newest = batches[-1]
    if len(batches) == 1:
        return newest
    changes = _sums(batches)
    warnings = {name: text for name, text in newest.health.items() if name != "errors"}
    messages = [one.health["errors"] for one in batches if "errors" in one.health]
    # What one batch has found of the system is so, whatever the next one happens to show.
    for one in batches:
        warnings |= {name: text for name, text in one.health.items() if name in _LASTING}
    warnings |= health.of_errors(changes["errors"], changes["rollouts"], max_error_rate, messages)
    whole = _counts(batches) or _runs(batches) or _weighted(batches)
    if whole is not None:
        changes |= {
            "probability": whole.mean,
            "relative_error": math.sqrt(whole.relative_variance),
            "interval_at": whole.evidence.interval_at,
            "run_probabilities": np.concatenate([one.run_probabilities for one in batches]),
        }
    return replace(newest, health=warnings, **changes)


def _sums(batches: Sequence[Result]) -> dict[str, Any]:
    """What it cost and what was found, all batches together."""
    names = ("rollouts", "simulated_steps", "errors", "seconds")
    newest, worst = batches[-1], [one.worst for one in batches if not math.isnan(one.worst.robustness)]
    count = sum(one.failures.count for one in batches)
    return {name: sum(getattr(one, name) for one in batches) for name in names} | {
        "failures": Failures(newest.failures.noise, newest.failures.robustness, count),
        "worst": min(worst, key=lambda one: one.robustness, default=newest.worst),
    }


def _counts(batches: Sequence[Result]) -> _Whole | None:
    """Binomial counts added up."""
    found = [evidence_of(one) for one in batches]
    counts = [one for one in found if isinstance(one, Binomial)]
    if len(counts) < len(found):
        return None
    failures, trials = sum(one.failures for one in counts), sum(one.trials for one in counts)
    p = failures / trials
    relative = (1.0 - p) / (p * trials) if failures else math.nan
    return _Whole(p, relative, Binomial(failures, trials, sum(one.undecided for one in counts)))


def _runs(batches: Sequence[Result]) -> _Whole | None:
    """The runs of all batches as runs of one estimate; one that died out is 0 among them."""
    parts = [one.run_probabilities for one in batches]
    laws = [evidence_of(one) for one in batches]
    known = all(
        isinstance(law, (Binomial, LogNormal)) or not part.any()
        for law, part in zip(laws, parts, strict=True)
    )
    values = np.concatenate(parts)
    if not known or min(map(len, parts)) < 2 or not values.any():
        return None
    mean = float(values.mean())
    least = min(law.relative_variance for law in laws if isinstance(law, LogNormal)) / len(batches)
    relative = float((values / mean).var(ddof=1)) / len(values) or least
    undecided = sum(
        law.undecided * len(part) for law, part in zip(laws, parts, strict=True) if isinstance(law, LogNormal)
    )
    return _Whole(mean, relative, LogNormal(mean, relative, len(values) - 1, undecided / len(values)))


def _weighted(batches: Sequence[Result]) -> _Whole | None:
    """Single runs, weighted by their rollouts: a share that was planned, not found."""
    laws = [law for one in batches if isinstance(law := evidence_of(one), LogNormal)]
    if len(laws) < len(batches):
        return None
    shares = [one.rollouts / sum(two.rollouts for two in batches) for one in batches]
    pairs = list(zip(shares, laws, strict=True))
    mean = sum(share * law.mean for share, law in pairs)
    relative = sum((share * law.mean / mean) ** 2 * law.relative_variance for share, law in pairs)
    freedom = sum(law.freedom for law in laws)
    undecided = sum(share * law.undecided for share, law in pairs)
    return _Whole(mean, relative, LogNormal(mean, relative, freedom, undecided))
