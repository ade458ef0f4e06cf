"""Splitting as the code of stl-ams ran its Algorithm 2, for comparison.

It differs from the unbiased form in three ways: K + 1 particles are discarded at a level, levels are on the
robustness of the prefix (Eq. 14), and robustness <= 0 counts as a failure.
"""

from __future__ import annotations

from avrare.rollout.problem import Problem
from avrare.rollout.request import Rollouts
from avrare_estimators.ams.splitting import Splitting
from avrare_estimators.ams.state import AmsState


class PublishedSplitting(Splitting):
    """Estimator ``ams`` with ``variant: published``."""

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem with the robustness of the prefix as its score."""
        return problem.rescore("prefix")

    def _store(self, state: AmsState, rollouts: Rollouts) -> None:
        super()._store(state, rollouts)
        state.population.violated[:] = (state.population.final >= 0.0) & ~state.population.error

    def _discard(self, state: AmsState) -> int:
        return super()._discard(state) + 1
