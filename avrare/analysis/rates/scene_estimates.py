"""Estimates of rules in the scenes of a catalogue, as they stand in the scenes' run folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from avrare.analysis.rates.combination import Quantity, from_rollouts
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import find_doubts


@dataclass(frozen=True)
class SceneEstimate:
    """Estimate of one rule in one scene.

    Attributes:
        result: The estimate.
        by_own_estimator: Whether the scene's own estimator made it, and not a share of Monte Carlo.
    """

    result: Result
    by_own_estimator: bool = False

    @property
    def follows_counts(self) -> bool:
        """True where the interval follows from the numbers of failures and rollouts alone.

        The counts of an ensemble are of one model, and its rollouts of all.
        """
        return not (self.by_own_estimator or self.result.members)

    @property
    def cost(self) -> int:
        """Part of the rollouts in the cost of the scene's own estimator; 0 where it has none."""
        return self.result.rollouts // self.result.shared_by if self.by_own_estimator else 0

    @property
    def warnings(self) -> dict[str, str]:
        """Health warnings, name to message, except for harmless ones."""
        # rounding says nothing against an estimate
        return {name: text for name, text in self.result.health.items() if name != "rounding"}

    @property
    def doubts(self) -> frozenset[str]:
        """Names of the warnings that doubt the estimate, and not only the system."""
        return find_doubts(self.warnings)

    def quantity(self, confidence: float, few: bool) -> Quantity:
        """Return the probability with its interval; ``few`` as in ``from_rollouts``."""
        result = self.result
        if self.follows_counts:
            return from_rollouts(result.failures.count, result.rollouts, result.errors, confidence, few)
        return Quantity(result.probability, *result.interval)


SceneEstimates = Mapping[str, SceneEstimate]
"""Estimates of one scene by rule."""
