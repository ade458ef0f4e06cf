"""Estimates of rules in the scenes of a catalogue, as they stand in the scenes' run folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from avrare.analysis.check.criteria import find_doubts
from avrare.analysis.rates.combination import Interval, Quantity, from_rollouts
from avrare.results.reader import StoredEstimate

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
    def read(entry: Mapping[str, Any], together: int = 0) -> SceneEstimate:
        """Read an entry of result.json.

        Args:
            entry: The entry.
            together: Number of rules that the scene's own estimator has judged on the same rollouts; 0: it is
                no estimate of the scene's own estimator, but by a share of Monte Carlo.
        """
        stored = StoredEstimate.model_validate(entry)
        found, said = stored.diagnostics or {}, stored.warnings or {}
        estimate = SceneEstimate(
            stored.failures, stored.rollouts, stored.errors,
            warnings={name: said.get(name, name) for name in stored.health if name != _HARMLESS},
        )  # fmt: skip
        # The counts of an ensemble are of one model and its rollouts of all: only its interval speaks for it.
        if not together and "model" not in found:
            return estimate
        own = OwnEstimate(
            stored.estimator, stored.probability, stored.interval, stored.simulated_steps,
            stored.relative_error, stored.blind_bound,
        )  # fmt: skip
        parts = found["choice"].get("shared_by", 1) if "choice" in found else together
        return replace(estimate, own=own, cost=stored.rollouts // parts if together else 0)


SceneEstimates = Mapping[str, SceneEstimate]
"""Estimates of one scene by rule."""
