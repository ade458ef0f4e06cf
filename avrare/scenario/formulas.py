"""What can be said of a scenario's formulas before anything runs: errors, warnings, and how far they look."""

from __future__ import annotations

from fractions import Fraction

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.parse import parse_with_warnings
from avrare.scenario.explain import Problem
from avrare.scenario.schema import Block, Formula, ScoreFormula
from avrare.scenario.source import Node, Path

_ANY_STEP = Fraction(1, 10**9)
"""A step of which every sensible time bound is a multiple, for simulators that do not tell theirs."""


def step_of(simulator: Block | None) -> float | None:
    """The step [s] that a simulator's option ``dt`` tells, None where there is none."""
    dt = getattr(simulator.config, "dt", None) if simulator else None
    return float(dt) if isinstance(dt, (int, float)) and not isinstance(dt, bool) else None


def check_formula(
    part: Formula, node: Node, path: Path, dt: float | None, steps: int | None
) -> tuple[list[Problem], list[Problem]]:
    """Errors and warnings of one formula; its signals are known once the simulator is built.

    Args:
        part: The specification, and the formula that it is scored by.
        node: Where it is written.
        path: Keys that lead to it.
        dt: Step of the simulator [s], which tells how many samples a time bound is; None if not known.
        steps: Of a rollout, None if not known.
    """
    problems, warnings = _check(part.stl, node, path, dt, steps)
    if isinstance(part.score, ScoreFormula):
        more, doubts = _check(part.score.stl, node.entries["score"], (*path, "score"), dt, steps)
        problems, warnings = problems + more, warnings + doubts
    return problems, warnings


def _check(
    text: str, node: Node, path: Path, dt: float | None, steps: int | None
) -> tuple[list[Problem], list[Problem]]:
    mark, path = node.entries["stl"].mark, (*path, "stl")
    try:
        formula, complaints = parse_with_warnings(text, _ANY_STEP if dt is None else dt)
    except FormulaError as error:
        return [Problem(mark, path, error.message, error.hint)], []
    warnings = [Problem(mark, path, complaint.message, complaint.hint) for complaint in complaints]
    if dt is not None and steps is not None:
        warnings += [Problem(mark, path, text) for text in reach_warnings(formula, steps)]
    return [], warnings


def reach_warnings(formula: f.Node, steps: int) -> list[str]:
    """Warnings on a formula that looks further ahead than a run is long.

    Looking back further is no mistake: what lies before the start is nowhere, and windows end there.

    Args:
        formula: Of which unbounded operators mean the whole run; what lies below them counts.
        steps: Of a run.
    """
    span = f.bounded_span(formula)
    if span <= steps:
        return []
    run = f"a run has {steps} step{'s' * (steps != 1)}"
    return [f"looks {span} samples ahead but {run}: what lies beyond counts as if the trace ended"]
