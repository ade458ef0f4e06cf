"""Nested levels with exact slices, as an estimator of its own."""

from __future__ import annotations

from avrare.rollout.problem import Problem
from avrare_estimators.nested import NestedLevels
from avrare_linear.estimator_config import LinearEssConfig
from avrare_linear.kernel import ExactKernel, solvable


def build(config: LinearEssConfig, scene: object | None = None) -> LinearLevels:
    """The estimator of a scenario or a call."""
    return LinearLevels(config)


class LinearLevels(NestedLevels):
    """``ess`` for affine systems and predicates; the system's map is found before the first rollout."""

    name = "ess_linear"

    def __init__(self, config: LinearEssConfig) -> None:
        self.config, self.moves = config, config.moves  # the kernel is made for the problem

    def prepare(self, problem: Problem) -> Problem:
        """The problem with a score that can be solved; makes the kernel.

        Raises:
            UsageError: The system or a predicate is not affine in the noise.
        """
        problem = solvable(problem)
        self.kernel = ExactKernel.of(problem, self.moves)
        return problem
