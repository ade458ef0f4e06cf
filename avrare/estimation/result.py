"""Result of an estimate: probability, interval, cost and health warnings."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from avrare.protocols import Floats

Interval = tuple[float, float]
_WORST_FIRST = ("fail", "inconclusive", "pass")
FAILURE_LIMIT = 100
"""Largest number of failing tapes that a result keeps."""


@dataclass(frozen=True)
class Failures:
    """Failing noise tapes, up to a limit."""

    noise: Floats  # (F, steps + 1, noise_size)
    robustness: Floats  # (F,)
    count: int  # number of failing rollouts, kept or not


@dataclass(frozen=True)
class Worst:
    """The rollout with the least robustness."""

    noise: Floats  # (steps + 1, noise_size)
    robustness: float  # NaN when every rollout ended in an error


@dataclass(frozen=True)
class CrossCheckResult:
    """Second estimate of the same probability, by an estimator of another family; its cost is its own.

    Attributes:
        estimator: Name of the estimator.
        outcome: "agree", "disagree" or "inconclusive".
        text: The check in words, for instance "cross-check by ess agrees: 1.2e-4 (5e-5 .. 3e-4)".
        share: Cost that was meant for it, as a share of the estimate's.
        probability: Its estimate; None where it did not run.
        interval: Its interval.
        noticed: Least factor between the two estimates that would have counted as disagreement.
        rollouts: Number of starts and branches.
        simulated_steps: Particle rows passed to ``System.step``.
        seconds: Wall time [s].
    """

    estimator: str
    outcome: str
    text: str
    share: float
    probability: float | None = None
    interval: Interval | None = None
    noticed: float | None = None
    rollouts: int = 0
    simulated_steps: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Result:
    """One estimate of one specification's failure probability.

    Attributes:
        specification: Name of the specification.
        estimator: Name of the estimator.
        probability: Mean of ``run_probabilities``.
        interval_at: Function from a confidence to the interval.
        confidence: Level of ``interval``, in (0, 1).
        run_probabilities: Estimate of each run (runs,); 0.0 for a run that died out.
        relative_error: Standard error over probability; NaN where the probability is 0.
        rollouts: Number of starts and branches.
        simulated_steps: Particle rows passed to ``System.step``.
        errors: Number of rollouts that ended in an error.
        health: Health warnings, name to message; empty when there are none.
        failures: Failing tapes.
        worst: Least robust rollout.
        robustness: Robustness of each complete rollout of the first stage, NaN for errors.
        counts: Counters of the system, summed over all rollouts.
        diagnostics: Further data of the estimator (levels, roots, ...), JSON-ready.
        blind_bound: Upper bound, at ``confidence``, for failures that the score or proposal does not lead to;
            None where every rollout was drawn from the target, as in Monte Carlo.
        cross_check: Second estimate that the option ``cross_check`` asked for; not in the cost above.
        seconds: Wall time [s]; no other field depends on it.
        relation: Definition of failure: "violated", the formula is false at sample 0, or "robustness <= 0".
        verdict: Verdict on the threshold of the scenario: "pass", "fail", "inconclusive" or None.
    """

    specification: str
    estimator: str
    probability: float
    interval_at: Callable[[float], Interval]
    confidence: float
    run_probabilities: Floats
    relative_error: float
    rollouts: int
    simulated_steps: int
    errors: int
    health: dict[str, str]
    failures: Failures
    worst: Worst
    robustness: Floats
    counts: dict[str, int] = field(default_factory=dict)
    diagnostics: dict[str, Any] = field(default_factory=dict)
    blind_bound: float | None = None
    cross_check: CrossCheckResult | None = None
    seconds: float = 0.0
    relation: str = "violated"
    verdict: str | None = None

    @cached_property
    def interval(self) -> Interval:
        """Interval (lo, hi) with 0 <= lo <= probability <= hi <= 1."""
        return self.interval_at(self.confidence)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of result.json; NaN and infinities become None."""
        entry = {
            "specification": self.specification,
            "estimator": self.estimator,
            "probability": self.probability,
            "interval": list(self.interval),
            "confidence": self.confidence,
            "blind_bound": self.blind_bound,
            "relative_error": self.relative_error,
            "rollouts": self.rollouts,
            "simulated_steps": self.simulated_steps,
            "failures": self.failures.count,
            "errors": self.errors,
            "seconds": round(self.seconds, 3),
            "health": list(self.health),
            "verdict": self.verdict,
            "warnings": self.health,
            "cross_check": asdict(self.cross_check) if self.cross_check else None,
            "run_probabilities": self.run_probabilities.tolist(),
            "relation": self.relation,
            "worst_robustness": self.worst.robustness,
            "counts": self.counts,
            "diagnostics": self.diagnostics,
        }
        return finite(entry)  # type: ignore[no-any-return]

    def to_json(self) -> str:
        """Return ``to_dict`` as JSON text."""
        return json.dumps(self.to_dict())


def finite(value: Any) -> Any:
    """Replace NaN and infinities by None, as JSON cannot write them."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return value


def verdict(result: Result, limit: float, strict: bool, confidence: float) -> str:
    """Return "pass" where the interval is below ``limit`` (at it, unless ``strict``), "fail" where above."""
    low, high = result.interval_at(confidence)
    if high < limit or (high == limit and not strict):
        return "pass"
    if low > limit or (low == limit and strict):
        return "fail"
    return "inconclusive"


def worst_verdict(verdicts: Iterable[str | None]) -> str | None:
    """Return the worst of several verdicts, or None if there is none."""
    found = set(verdicts)
    return next((name for name in _WORST_FIRST if name in found), None)
