"""Estimates of rules in the scenes of a catalogue, as they stand in the scenes' run folders."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from avrare.analysis.check.criteria import find_doubts
from avrare.analysis.rates.combination import Interval, Quantity, from_rollouts
from avrare.estimation.result.result import Result

_HARMLESS = "rounding"
"""Warning that says nothing against an estimate."""


@dataclass(frozen=True)
class OwnEstimate:
    """Probability with an interval that does not follow from counts alone.

    Attributes:
        estimator: What has estimated it.
        probability: The estimate.
        interval: Its own interval, of the catalogue's level.
        simulated_steps: Its cost in steps.
        relative_error: Its standard error over the probability; None where that is 0.
        blind_bound: Upper bound for failures that its score or proposal does not lead to; None: none is left.
    """

    estimator: str
    probability: float
    interval: Interval
    simulated_steps: int = 0
    relative_error: float | None = None
    blind_bound: float | None = None


@dataclass(frozen=True)
class SceneEstimate:
    """Estimate of one rule in one scene.

    Attributes:
        failures: Failing rollouts.
        rollouts: Rollouts; those of estimates that share them stand in each.
        errors: Rollouts that ended in an error.
        own: The estimate where it is not that of Monte Carlo rollouts with equal weights.
        warnings: Health warnings, name to message.
        cost: Part of the rollouts in the cost of the scene's own estimator; 0 where it has none.
    """

    failures: int
    rollouts: int
    errors: int = 0
    own: OwnEstimate | None = None
    warnings: Mapping[str, str] = field(default_factory=dict)
    cost: int = 0

    @property
    def doubts(self) -> frozenset[str]:
        """Names of the warnings that doubt the estimate, and not only the system."""
        return find_doubts(self.warnings)

    def quantity(self, confidence: float, few: bool) -> Quantity:
        """Return the probability with its interval; ``few`` as in ``from_rollouts``."""
        if self.own is not None:
            return Quantity(self.own.probability, *self.own.interval)
        return from_rollouts(self.failures, self.rollouts, self.errors, confidence, few)

    @staticmethod
    def of(result: Result, together: int = 0) -> SceneEstimate:
        """Return the estimate of a rule from a result of its scene.

        Args:
            result: The result.
            together: Number of rules that the scene's own estimator has judged on the same rollouts; 0: the
                estimate is not that of the scene's own estimator, but of a share of Monte Carlo.
        """
        warnings = {name: text for name, text in result.health.items() if name != _HARMLESS}
        estimate = SceneEstimate(result.failures.count, result.rollouts, result.errors, warnings=warnings)
        # The counts of an ensemble are of one model and its rollouts of all: only its interval speaks for it.
        if not together and "model" not in result.diagnostics:
            return estimate
        own = OwnEstimate(
            result.estimator,
            result.probability,
            result.interval,
            result.simulated_steps,
            None if math.isnan(result.relative_error) else result.relative_error,
            result.blind_bound,
        )
        choice = result.diagnostics.get("choice")
        parts = together if choice is None else choice.get("shared_by", 1)
        return replace(estimate, own=own, cost=result.rollouts // parts if together else 0)


SceneEstimates = Mapping[str, SceneEstimate]
"""Estimates of one scene by rule."""
