"""The answer: a probability with an interval, what it cost, and what should make one doubt it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from avrare.protocols import Floats

Interval = tuple[float, float]


@dataclass(frozen=True)
class Failures:
    """Failing noise tapes, up to a limit.

    Attributes:
        noise: (F, steps + 1, noise_size).
        robustness: (F,).
        count: All failing rollouts that were seen, kept or not.
    """

    noise: Floats
    robustness: Floats
    count: int


@dataclass(frozen=True)
class Worst:
    """The rollout with the least robustness.

    Attributes:
        noise: (steps + 1, noise_size).
        robustness: Its robustness; NaN when every rollout broke down.
    """

    noise: Floats
    robustness: float


@dataclass(frozen=True)
class Result:
    """One estimate of one specification's failure probability.

    Attributes:
        specification: Its name in the problem.
        estimator: Name of the estimator.
        probability: Mean of ``run_probabilities``.
        interval_at: The interval at any confidence.
        confidence: Of ``interval``.
        run_probabilities: (runs,); a run that died out is 0.0 in it.
        relative_error: Standard error over probability; NaN where the probability is 0.
        rollouts: Starts and branches, each counted as one.
        simulated_steps: Particle rows passed to ``System.step``.
        errors: Rollouts that broke down.
        health: Named warnings and what they mean; empty when all is well.
        failures: Failing tapes.
        worst: The least robust rollout.
        robustness: Robustness of every complete rollout of the first stage, NaN for errors.
        counts: The system's own counters, summed over all rollouts.
        diagnostics: What the estimator wants to say beyond that (levels, roots, ...), JSON-ready.
        seconds: Wall time; no other field depends on it.
        relation: What counts as failure: "violated", the formula is false at sample 0, or "robustness <= 0".
        verdict: Of the scenario's threshold: "pass", "fail", "inconclusive" or None.
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
    seconds: float = 0.0
    relation: str = "violated"
    verdict: str | None = None

    @cached_property
    def interval(self) -> Interval:
        """0 <= lo <= probability <= hi <= 1."""
        return self.interval_at(self.confidence)

    def to_dict(self) -> dict[str, Any]:
        """The entry of result.json; NaN and infinities become null."""
        entry = {
            "specification": self.specification,
            "estimator": self.estimator,
            "probability": self.probability,
            "interval": list(self.interval),
            "confidence": self.confidence,
            "relative_error": self.relative_error,
            "rollouts": self.rollouts,
            "simulated_steps": self.simulated_steps,
            "failures": self.failures.count,
            "errors": self.errors,
            "seconds": round(self.seconds, 3),
            "health": list(self.health),
            "verdict": self.verdict,
            "warnings": self.health,
            "run_probabilities": self.run_probabilities.tolist(),
            "relation": self.relation,
            "worst_robustness": self.worst.robustness,
            "counts": self.counts,
            "diagnostics": self.diagnostics,
        }
        return finite(entry)  # type: ignore[no-any-return]

    def to_json(self) -> str:
        """``to_dict`` as JSON text."""
        return json.dumps(self.to_dict())


def finite(value: Any) -> Any:
    """The value with NaN and infinities replaced by None, as JSON has no word for them."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return value
