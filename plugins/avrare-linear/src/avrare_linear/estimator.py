"""Estimator ``ess_linear``: nested levels with exact slices."""

from __future__ import annotations

from avrare.rollout.problem import Problem
from avrare_estimators.common.chains.kernel import Kernel
from avrare_estimators.ess.estimator import NestedLevels
from avrare_linear.estimator_config import LinearEssConfig
from avrare_linear.kernel import ExactKernel, to_solvable


def build(config: LinearEssConfig, scene: object | None = None) -> LinearLevels:
    """Build the estimator."""
    return LinearLevels(config)


class LinearLevels(NestedLevels):
    """``ess`` for affine systems and predicates; the affine map is computed before the first rollout."""

    name = "ess_linear"

    def __init__(self, config: LinearEssConfig) -> None:
        super().__init__(config, Kernel())  # prepare makes the kernel, which must know the system
        self.moves = config.moves

    def prepare(self, problem: Problem) -> Problem:
        """Make the kernel, and return the problem with a score that it can solve.

        Raises:
            UsageError: The system or a predicate is not affine in the noise.
        """
        problem = to_solvable(problem)
        self.kernel = ExactKernel.of(problem, self.moves)
        return problem
