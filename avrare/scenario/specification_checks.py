"""Static checks of specifications: formulas by their parser, plugins' specifications by their own check."""

from __future__ import annotations

from fractions import Fraction

from avrare.base.errors import FormulaError
from avrare.base.health_messages import MESSAGES
from avrare.logic.syntax import nodes
from avrare.logic.syntax.lint import choose_warnings
from avrare.logic.syntax.parser import parse_with_warnings
from avrare.scenario.schema import Block, Formula, ScoreFormula
from avrare.scenario.validation import Mistake, failed_check
from avrare.scenario.value_positions import Node, Path


def step_of(simulator: Block | None) -> float | None:
    """Return the simulator's option ``dt`` [s], or None if it has none."""
    dt = None if simulator is None else dict(simulator.config).get("dt")
    return float(dt) if isinstance(dt, (int, float)) and not isinstance(dt, bool) else None


def check_specification(
    part: Block | Formula, node: Node, path: Path, dt: float | None, steps: int | None
) -> tuple[list[Mistake], list[Mistake]]:
    """Return errors and warnings of a specification at ``path``; ``dt`` [s] and ``steps`` may be unknown.

    The signals are known only once the simulator is built.
    """
    if isinstance(part, Block):
        return _check_block(part, node, path, dt)
    errors, warnings = _check_text(part.stl, part.until, node, path, dt, steps)
    if isinstance(part.score, ScoreFormula):
        score = _check_text(part.score.stl, part.until, node.entries["score"], (*path, "score"), dt, steps)
        errors, warnings = errors + score[0], warnings + score[1]
    return errors, warnings


def _check_text(
    text: str, until: str, node: Node, path: Path, dt: float | None, steps: int | None
) -> tuple[list[Mistake], list[Mistake]]:
    mark, path = node.entries["stl"].mark, (*path, "stl")
    try:
        # without a step, bounds are multiples of 1 ns
        formula, lint = parse_with_warnings(text, Fraction(1, 10**9) if dt is None else dt)
    except FormulaError as error:
        return [Mistake(mark, path, error.message, error.hint)], []
    warnings = [
        Mistake(mark, path, warning.message, warning.hint) for warning in choose_warnings(lint, until)
    ]
    if dt is not None and steps is not None:
        warnings += [Mistake(mark, path, text) for text in reach_warnings(formula, steps)]
    return [], warnings


def reach_warnings(formula: nodes.Node, steps: int) -> list[str]:
    """Return a warning if the bounded operators of a formula look further ahead than a rollout is long."""
    span = nodes.bounded_span(formula)
    if span <= steps:
        return []
    return [MESSAGES["horizon_short"].format(horizon=span, steps=steps)]


def _check_block(
    block: Block, node: Node, path: Path, dt: float | None
) -> tuple[list[Mistake], list[Mistake]]:
    """Return errors and warnings of a component's own check, if it has one."""
    errors: list[Mistake] = []
    warnings: list[Mistake] = []
    try:
        for finding in block.component.find_faults(block.config, dt):
            option_node = node.child(finding.option) if finding.option is not None else None
            mark = node.name_mark if option_node is None else option_node.mark
            place = path if finding.option is None else (*path, finding.option)
            mistake = Mistake(mark, place, finding.message, finding.hint)
            (errors if finding.is_error else warnings).append(mistake)
    except (Exception, SystemExit) as error:
        return [failed_check(error, node, path)], []
    return errors, warnings
