"""Reference problem: a system, a formula, and the exact probability that the system violates it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from avrare.logic.formula import stl
from avrare.protocols import System
from avrare.rollout.problem import Problem
from avrare.rollout.scores.scored_specifications import ScoreFunction


@dataclass(frozen=True)
class ReferenceProblem:
    """A problem with a known answer.

    Attributes:
        id: Name: "d_rw_L2.5", or for generated problems the generator with its arguments.
        family: Name of the generator, see ``avrare.testing.problems.families``.
        text: Description in words and symbols.
        system: Batched system; importable, so that worker processes can build it.
        formula: Specification as formula text.
        steps: Number of steps (states t = 0..steps); 0 for a static problem.
        relation: Robustness of failures: "<=0", or "<0" where 0 passes (or has no probability).
        exact: Function that computes the probability, to nine digits or more.
        score: Score for splitting where minus the robustness is a poor one, else None.
        published: Published probability, None to compute it.
    """

    id: str
    family: str
    text: str
    system: System
    formula: str
    steps: int
    relation: str
    exact: Callable[[], float]
    score: ScoreFunction | None = None
    published: float | None = None

    @cached_property
    def probability(self) -> float:
        """Exact failure probability."""
        return self.exact() if self.published is None else self.published

    def problem(self, score: ScoreFunction | str | None = None, **keywords: Any) -> Problem:
        """Return the problem as estimators take it.

        Args:
            score: Score in place of ``self.score``; "robustness": that of the formula.
            **keywords: Further arguments of ``avrare.Problem``, for example ``chunk``.
        """
        return Problem(self.system, stl(self.formula), self.steps, score or self.score, **keywords)
