"""Text to formula: rtamt's syntax, with rational time bounds and errors that point at the place."""

from __future__ import annotations

import functools
import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.bounds import Period, sample_bounds
from avrare.logic.complaints import complain, explain
from avrare.logic.tokens import MEANING, Ambiguous, Words

if TYPE_CHECKING:
    from lark import Lark

MAX_DEPTH = 100
"""Deeper nesting is refused: evaluation is recursive."""

_ARITY = {"abs": 1, "sqrt": 1, "exp": 1, "log": 1, "pow": 2}


def parse(text: str, dt: float | Fraction = 1.0) -> f.Node:
    """The formula that ``text`` stands for.

    Args:
        text: The formula.
        dt: Sampling period [s].

    Raises:
        FormulaError: With line, column, the line itself and a mark below the place.
    """
    from lark.exceptions import UnexpectedInput

    if not isinstance(text, str):
        raise FormulaError(f"a formula is text, not {type(text).__name__}")
    reader = _Reader(text, Period.of(dt))
    try:
        tree: Any = _parser().parse(text)
        node = reader.formula(tree.children[0])
    except UnexpectedInput as error:
        raise explain(text, error) from None
    except Ambiguous as error:
        raise complain(text, error.token, error.message, error.hint) from None
    except RecursionError:
        node = None
    if node is None or f.depth(node) > MAX_DEPTH:
        raise FormulaError(
            f"the formula is nested more than {MAX_DEPTH} levels deep", "give its parts as signals"
        )
    return node


@functools.cache
def _parser() -> Lark:
    from lark import Lark

    return Lark.open(
        "grammar.lark",
        rel_to=__file__,
        parser="lalr",
        lexer="basic",
        postlex=Words(),
        propagate_positions=True,
    )


def _meaning(token: Any) -> str:
    return MEANING.get(str(token), str(token))


class _Reader:
    """Turns lark's tree into a formula, telling formulas from terms."""

    def __init__(self, text: str, period: Period) -> None:
        self.text = text
        self.period = period

    def formula(self, tree: Any) -> f.Node:
        """The tree as a formula; a bare term is a predicate."""
        item = self.item(tree)
        return f.Predicate(item) if isinstance(item, f.Term) else item

    def term(self, tree: Any) -> f.Term:
        """The tree as a term."""
        item = self.item(tree)
        if isinstance(item, f.Term):
            return item
        hint = "compare terms, join formulas with and, or, ->"
        raise complain(self.text, tree.meta, "a number is needed here, not a formula", hint)

    def item(self, tree: Any) -> f.Node | f.Term:
        """The tree as whichever it is."""
        method = getattr(self, f"_{tree.data}")
        item: f.Node | f.Term = method(tree, *tree.children)
        return item

    def _quantified(self, tree: Any, op: Any, *rest: Any) -> f.Node:
        child = self.formula(rest[-1])
        return f.Forall(child) if op == "forall" else f.Exists(child)

    def _connective(self, tree: Any, left: Any, op: Any, right: Any) -> f.Node:
        return f.Connective(_meaning(op), self.formula(left), self.formula(right))

    def _implication(self, tree: Any, left: Any, op: Any, right: Any, *more: Any) -> f.Node:
        if more:
            hint = "write (a -> b) -> c or a -> (b -> c): tools differ on which is meant"
            raise complain(self.text, more[0], "'->' does not chain", hint)
        return f.Connective("implies", self.formula(left), self.formula(right))

    def _until(self, tree: Any, left: Any, op: Any, *rest: Any) -> f.Node:
        lo, hi = self._bounds(rest)
        return f.Until(_meaning(op), lo, hi, self.formula(left), self.formula(rest[-1]))

    def _negation(self, tree: Any, op: Any, child: Any) -> f.Node:
        return f.Not(self.formula(child))

    def _window(self, tree: Any, op: Any, *rest: Any) -> f.Node:
        lo, hi = self._bounds(rest)
        return f.Window(_meaning(op), lo, hi, self.formula(rest[-1]))

    def _step(self, tree: Any, op: Any, child: Any) -> f.Node:
        return f.Step(_meaning(op), self.formula(child))

    def _bounds(self, rest: Any) -> tuple[int, float]:
        return sample_bounds(self.text, rest[0], self.period) if len(rest) > 1 else (0, math.inf)

    def _compared(self, tree: Any, left: Any, op: Any, right: Any, *more: Any) -> f.Node:
        if more:
            hint = "write 0 < x and x < 3 for 0 < x < 3"
            raise complain(self.text, more[0], "comparisons do not chain", hint)
        return f.Comparison(_meaning(op), self.term(left), self.term(right))

    def _arithmetic(self, tree: Any, left: Any, op: Any, right: Any) -> f.Term:
        return f.Arithmetic(str(op), self.term(left), self.term(right))

    def _negative(self, tree: Any, op: Any, operand: Any) -> f.Term:
        if operand.data == "number":
            return f.Number(-self._number(operand, *operand.children).value)
        return f.Negative(self.term(operand))

    def _number(self, tree: Any, token: Any) -> f.Number:
        value = float(token)
        if math.isinf(value):
            raise complain(self.text, token, "the number is too large")
        return f.Number(value)

    def _signal(self, tree: Any, name: Any) -> f.Term:
        return f.Signal(str(name))

    def _constant(self, tree: Any, word: Any) -> f.Node:
        return f.Constant(word == "true")

    def _call(self, tree: Any, name: Any, *arguments: Any) -> f.Term:
        function = _meaning(name)
        wanted = _ARITY.get(function)
        if len(arguments) != wanted if wanted else len(arguments) < 2:
            count = f"{wanted} argument{'s' if wanted != 1 else ''}" if wanted else "two or more arguments"
            raise complain(self.text, name, f"{name} takes {count}, not {len(arguments)}")
        return f.Call(function, tuple(self.term(argument) for argument in arguments))
