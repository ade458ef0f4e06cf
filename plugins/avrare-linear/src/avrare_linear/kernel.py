"""Elliptical slice sampling with slices in closed form: many steps for one rollout, none wasted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.logic.normal import core
from avrare.logic.online import FormulaMonitor
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.score import FunctionScored, MarginScored
from avrare_estimators.chains import TURN, Draw, Move, Points, Untaught, rotated
from avrare_linear.ellipse import Slicer
from avrare_linear.ellipse import draw as uniform


@dataclass(frozen=True)
class WholeTrace:
    """A score for formulas that may still come true: minus the robustness of the whole run, at its end.

    Chains look at whole runs only; splitting needs a score that grows on the way.

    Attributes:
        formula: What is scored.
        steps: Of a run.
    """

    formula: Formula
    steps: int

    def __call__(self, signals: dict[str, Any], t: int) -> Floats:
        """(N,) score after sample t."""
        if t < self.steps:
            return np.full(len(next(iter(signals.values()))), -np.inf)
        return -self.formula.robustness(signals)[:, 0]


@dataclass(frozen=True)
class Threshold:
    """The robustness below which a score's level puts a run.

    Attributes:
        nominal: (T + 1,) margins of the noise-free run where the score is "margin", else None.
    """

    nominal: Floats | None = None

    def __call__(self, level: Floats) -> Floats:
        """(M,), or (M, T + 1) where it differs from sample to sample; never below that of failures."""
        if self.nominal is None:
            return np.maximum(-level, 0.0)
        return np.maximum(1.0 - level, 0.0)[:, None] * self.nominal


class ExactKernel(Untaught):
    """Valid for systems and predicates that are affine in the noise (an ``avrare_estimators.chains.Kernel``).

    Args:
        slicer: Of the problem's formula.
        threshold: Of the problem's score.
        moves: Ellipses that a chain goes along before its rollout, which none of them needs.
    """

    rollouts = 1.0

    def __init__(self, slicer: Slicer, threshold: Threshold, moves: int = 1) -> None:
        self.slicer = slicer
        self.threshold = threshold
        self.moves = moves

    @staticmethod
    def of(problem: Problem, moves: int = 1) -> ExactKernel:
        """The kernel of a problem, see ``solvable``.

        Raises:
            UsageError: The system or a predicate is not affine, or the score is one that cannot be solved.
        """
        formula, threshold = _formula(problem), _threshold(problem)
        if threshold is None:
            raise UsageError(
                f"exact slices cannot be had of the score of {problem.names[0]}",
                "use solvable(problem), or the score robustness or margin",
            )
        return ExactKernel(Slicer.of(problem.system, problem.steps, formula), threshold, moves)

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        """Fresh ellipses, and on each an angle on the part that lies in the set."""
        chains, threshold, tape = np.arange(len(level)), self.threshold(level), state.tape
        along = self.slicer.margins(tape)
        for move in range(self.moves):
            other = replace(draw, chain=draw.chain + move * TURN).tapes()
            across = self.slicer.margins(other)
            angle = uniform(self.slicer.cut(along, across, threshold), draw.uniforms(chains, move))
            tape, along = rotated(tape, other, angle), rotated(along, across, angle)
        return Move.begin(state, level, draw, tape, ())

    def tell(self, move: Move, found: Points) -> Move:
        """Go there; only rounding at the end of a segment can put a proposal outside the set."""
        return move.take(found.above(move.level[move.waiting]), found).stay()


def solvable(problem: Problem) -> Problem:
    """The problem with a score that exact slices can solve: its own, or ``WholeTrace``.

    Raises:
        UsageError: The specification is no formula.
    """
    formula = _formula(problem)
    if _threshold(problem) is not None:
        return problem
    return problem.rescored(WholeTrace(formula, problem.steps))


def _formula(problem: Problem) -> Formula:
    formula = getattr(problem.monitors[0], "formula", None)
    if not isinstance(formula, Formula):
        raise UsageError(f"exact slices need a formula, and {problem.names[0]} is none")
    return formula


def _threshold(problem: Problem) -> Threshold | None:
    """What the problem's score means, None where it has no closed form."""
    scored, node = problem.specifications[0], core(_formula(problem).node)
    if isinstance(scored, FormulaMonitor) and (problem.steps == 0 or _only_falls(node)):
        return Threshold()
    if isinstance(scored, FunctionScored) and isinstance(scored.function, WholeTrace):
        return Threshold()
    if isinstance(scored, MarginScored) and isinstance(node, f.Window) and not _looks_around(node.child):
        return Threshold(scored.nominal)
    return None


def _only_falls(node: f.Node) -> bool:
    """Whether the robustness of a longer prefix is never higher."""
    match node:
        case f.Connective("and", left, right):
            return _only_falls(left) and _only_falls(right)
        case f.Window("always", child=child):
            return f.horizon(child) == 0
    return f.horizon(node) == 0


def _looks_around(node: f.Node) -> bool:
    return f.horizon(node) > 0 or f.history(node) > 0
