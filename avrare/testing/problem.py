"""A reference problem: a system, its formula, and the exact probability that it is broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from avrare.logic.api import stl
from avrare.protocols import System
from avrare.rollout.problem import Problem
from avrare.rollout.score import ScoreFunction


@dataclass(frozen=True)
class ReferenceProblem:
    """A problem with a known answer.

    Attributes:
        id: Its name: "d_rw_L2.5", or for generated ones the generator with its arguments.
        family: Name of its generator, see ``avrare.testing.problems.families``.
        text: What it is, in words and symbols.
        system: Batched; importable, so that worker processes can build it.
        formula: What the system must do, in avrare's language.
        steps: States t = 0..steps; 0 is a static problem.
        relation: Robustness of failures: "<=0", or "<0" where 0 is no failure (or has no probability).
        exact: Computes the probability, to nine digits or more.
        score: A score for splitting where minus the robustness is a poor one, else None.
        known: Published probability, or None to compute it.
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
    known: float | None = None

    @cached_property
    def probability(self) -> float:
        """The exact failure probability."""
        return self.exact() if self.known is None else self.known

    def problem(self, score: ScoreFunction | str | None = None, **keywords: Any) -> Problem:
        """The problem as estimators take it.

        Args:
            score: Replaces the suggested one; "robustness" asks for the formula's own.
            **keywords: As ``avrare.Problem`` takes them, for example ``chunk``.
        """
        return Problem(self.system, stl(self.formula), self.steps, score or self.score, **keywords)
