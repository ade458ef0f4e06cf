"""Exact kernel: elliptical slice sampling with slices in closed form (stl-ess, Section IV)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.logic.formula import Formula, FormulaMonitor
from avrare.logic.semantics.normal_form import normalise
from avrare.logic.syntax import nodes
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.scores.progress_score import ProgressScored
from avrare.rollout.scores.scored_specifications import FormulaScored, FunctionScored, MarginScored
from avrare.rollout.scores.term_sizes import ScaledMonitor
from avrare_estimators.common.chains.kernel import TURN, Draw, Kernel, Move, Points, rotate
from avrare_linear.ellipse import Slicer, draw_angles
from avrare_linear.predicates import AffineFormula


@dataclass(frozen=True)
class WholeTrace:
    """Score of complete rollouts: minus the robustness at the last step, minus infinity before.

    Chains compare complete rollouts only; splitting needs a score that grows on the way.

    Attributes:
        formula: Formula that is scored.
        steps: Steps of a rollout.
        guide: Its terms divided by their sizes, to be scored in its place; None: all sizes are equal.
    """

    formula: Formula
    steps: int
    guide: ScaledMonitor | None = None

    def __call__(self, signals: dict[str, Floats], t: int) -> Floats:
        """Return the score (N,) after sample t."""
        if t < self.steps:
            return np.full(len(next(iter(signals.values()))), -np.inf)
        return -(self.guide or self.formula).robustness(signals)[:, 0]


@dataclass(frozen=True)
class RobustnessLevel:
    """Conversion of a score's level to the robustness below which a rollout reaches it.

    Attributes:
        nominal: (T + 1,) margins of the noise-free rollout for the score "margin", else None.
        sizes: (T + 1, P) sizes of the predicates' terms where the score divides by them, else None.
    """

    nominal: Floats | None = None
    sizes: Floats | None = None

    def __call__(self, level: Floats) -> Floats:
        """Return the robustness, at least 0: (M,), (M, T + 1), or (M, T + 1, P) by sample and predicate."""
        if self.sizes is not None:
            return np.maximum(-level, 0.0)[:, None, None] * self.sizes
        if self.nominal is None:
            return np.maximum(-level, 0.0)
        return np.maximum(1.0 - level, 0.0)[:, None] * self.nominal


class ExactKernel(Kernel):
    """Kernel with exact slices, for systems and predicates that are affine in the noise.

    Args:
        slicer: Slicer of the problem's formula.
        threshold: Robustness of a level of the problem's score.
        moves: Slice moves of a chain before each rollout.
    """

    name = "exact"

    def __init__(self, slicer: Slicer, threshold: RobustnessLevel, moves: int = 1) -> None:
        self.slicer = slicer
        self.threshold = threshold
        self.moves = moves

    @staticmethod
    def of(problem: Problem, moves: int = 1) -> ExactKernel:
        """Make the kernel of a problem; see ``to_solvable``.

        Raises:
            UsageError: The system or a predicate is not affine, or the score has no closed form.
        """
        formula, guide = _formula(problem), _guide(problem)
        if not _has_closed_form(problem):
            raise UsageError(
                f"the score of {problem.names[0]} has no exact slices",
                "use to_solvable(problem), or the score robustness or margin",
            )
        affine = AffineFormula.of(formula, apart=guide is not None)
        slicer = Slicer.of(problem.system, problem.steps, affine)
        scored = problem.specifications[0]
        if guide is not None:
            return ExactKernel(slicer, RobustnessLevel(sizes=_sizes(affine, guide)), moves)
        nominal = scored.nominal if isinstance(scored, MarginScored) else None
        return ExactKernel(slicer, RobustnessLevel(nominal), moves)

    def start(self, tuning: object, state: Points, level: Floats, draw: Draw) -> Move:
        """Move along fresh ellipses, to a uniform angle on the part inside the level set."""
        chains, threshold, tape = np.arange(len(level)), self.threshold(level), state.tape
        along = self.slicer.margins(tape)
        for move in range(self.moves):
            # 1. A fresh direction.
            other = replace(draw, chain=draw.chain + move * TURN).tapes()
            across = self.slicer.margins(other)
            # 2. A uniform angle on the segments inside the level set.
            angle = draw_angles(self.slicer.cut(along, across, threshold), draw.uniforms(chains, move))
            # 3. Turn the tape and its margins.
            tape, along = rotate(tape, other, angle), rotate(along, across, angle)
        return Move.begin(state, level, draw, tape, ())

    def tell(self, move: Move, points: Points) -> Move:
        """Accept the proposal, unless rounding at the end of a segment put it outside the set."""
        return move.accept(points.above(move.level[move.waiting]), points).stay()


def to_solvable(problem: Problem) -> Problem:
    """Return the problem with a score that has exact slices: its own, or ``WholeTrace``.

    Raises:
        UsageError: The specification is not a formula.
    """
    formula = _formula(problem)
    if _has_closed_form(problem):
        return problem
    return problem.rescore(WholeTrace(formula, problem.steps, _guide(problem)))


def _formula(problem: Problem) -> Formula:
    formula = problem.monitors[0].formula
    if not isinstance(formula, Formula):
        raise UsageError(f"exact slices need a formula: {problem.names[0]} is not given as stl")
    return formula


def _guide(problem: Problem) -> ScaledMonitor | None:
    # That of the specification's own terms.
    if isinstance(problem.score, Formula):
        return None
    match problem.specifications[0]:
        case (
            FunctionScored(function=WholeTrace(guide=ScaledMonitor() as guide))
            | FormulaScored(guide=ScaledMonitor() as guide)
            | FormulaScored(guide=MarginScored(inner=ScaledMonitor() as guide))
            | ProgressScored(guide=ScaledMonitor() as guide)
        ):
            return guide
    return None


def _has_closed_form(problem: Problem) -> bool:
    scored, node = problem.specifications[0], normalise(_formula(problem).node)
    match scored:
        case FunctionScored():
            return isinstance(scored.function, WholeTrace)
        case MarginScored():
            return isinstance(node, nodes.Window) and not _has_window(node.child)
        case FormulaMonitor() | FormulaScored(guide=ScaledMonitor()) if not isinstance(
            problem.score, Formula
        ):
            return problem.steps == 0 or _never_rises(node)
    return False


def _sizes(affine: AffineFormula, guide: ScaledMonitor) -> Floats:
    # (T + 1, P); a comparison that the formula negates has its opposite's size.
    sizes = {normalise(term, sign): size for term, size in guide.sizes.items() for sign in (True, False)}
    equal = np.ones(len(next(iter(sizes.values()))))
    return np.stack(
        [sizes.get(margin.term, equal) if margin.term else equal for margin in affine.margins], axis=1
    )


def _never_rises(node: nodes.Node) -> bool:
    # The robustness of a longer prefix is never higher.
    match node:
        case nodes.Connective("and", left, right):
            return _never_rises(left) and _never_rises(right)
        case nodes.Window("always", child=child):
            return nodes.horizon(child) == 0
    return nodes.horizon(node) == 0


def _has_window(node: nodes.Node) -> bool:
    return nodes.horizon(node) > 0 or nodes.history(node) > 0
