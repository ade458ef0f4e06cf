"""Nested levels that keep their samples, for pictures."""

from __future__ import annotations

from typing import Any

from avrare.protocols import Floats
from avrare_estimators.ess.estimator import NestedLevels
from avrare_estimators.ess.state import EssState


class RecordedLevels(NestedLevels):
    """Nested levels that keep the samples of every level of the pass that counts."""

    def init(self, plan: Any) -> Any:
        """Begin with nothing kept."""
        self.tapes: list[Floats] = []
        return super().init(plan)

    def tell(self, state: EssState, rollouts: Any) -> Any:
        """Count a new population as one more level."""
        before = state.level_pass.population
        after, info = super().tell(state, rollouts)
        population = after.level_pass.population
        if state.counting and population is not None and population is not before:
            self.tapes.append(population.tape)
        return after, info
