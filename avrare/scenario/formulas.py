"""What can be said of a scenario's formulas before anything runs: errors, warnings, and how far they look."""

from __future__ import annotations

import math
from fractions import Fraction

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.parse import parse_with_warnings
from avrare.scenario.explain import Problem
from avrare.scenario.schema import Block, Formula
from avrare.scenario.source import Node, Path

_ANY_STEP = Fraction(1, 10**9)
"""A step of which every sensible time bound is a multiple, for simulators that do not tell theirs."""


def check_formula(
    part: Formula, node: Node, path: Path, simulator: Block | None, steps: int | None
) -> tuple[list[Problem], list[Problem]]:
    """Errors and warnings of one formula; its signals are known once the simulator is built.

    Args:
        part: The specification.
        node: Where it is written.
        path: Keys that lead to it.
        simulator: Its option ``dt`` [s], if it has one, tells how many samples a time bound is.
        steps: Of a rollout, None if not known.
    """
    mark, path = node.entries["stl"].mark, (*path, "stl")
    dt = getattr(simulator.config, "dt", None) if simulator else None
    known = isinstance(dt, (int, float)) and not isinstance(dt, bool)
    try:
        formula, complaints = parse_with_warnings(part.stl, dt if known and dt is not None else _ANY_STEP)
    except FormulaError as error:
        return [Problem(mark, path, error.message, error.hint)], []
    warnings = [Problem(mark, path, complaint.message, complaint.hint) for complaint in complaints]
    if known and steps is not None:
        texts = reach_warnings(f.horizon(formula), f.history(formula), steps)
        warnings += [Problem(mark, path, text) for text in texts]
    return [], warnings


def reach_warnings(horizon: float, history: float, steps: int) -> list[str]:
    """Warnings on a formula that looks further than a run is long.

    Args:
        horizon: Samples that it looks ahead; unbounded operators mean the whole run and are fine.
        history: Samples that it looks back.
        steps: Of a run.
    """
    run = f"a run has {steps} step{'s' * (steps != 1)}"
    texts = []
    if steps < horizon < math.inf:
        texts.append(
            f"looks {horizon:.0f} samples ahead but {run}: what lies beyond counts as if the trace ended"
        )
    if steps < history < math.inf:
        texts.append(
            f"looks {history:.0f} samples back but {run}: what lies before counts as if the trace began there"
        )
    return texts
