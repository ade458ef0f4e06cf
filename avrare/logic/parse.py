"""Text to formula: rtamt's syntax, with rational time bounds and errors that point at the place."""

from __future__ import annotations

import functools
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic import warnings
from avrare.logic.bounds import Period
from avrare.logic.complaints import Complaint, complain, explain
from avrare.logic.declarations import blank_out
from avrare.logic.definitions import Definitions
from avrare.logic.reader import Reader
from avrare.logic.tokens import Unclear, Words

if TYPE_CHECKING:
    from lark import Lark

MAX_DEPTH = 100
"""Deeper nesting is refused: evaluation is recursive."""


def parse(text: str, dt: float | Fraction = 1.0) -> f.Node:
    """The formula that ``text`` stands for.

    Args:
        text: The formula, or statements with definitions of which the last is the formula.
        dt: Sampling period [s].

    Raises:
        FormulaError: With line, column, the line itself and a mark below the place.
    """
    return parse_with_warnings(text, dt)[0]


def parse_with_warnings(text: str, dt: float | Fraction = 1.0) -> tuple[f.Node, tuple[Complaint, ...]]:
    """The formula that ``text`` stands for, and what in the text is often not what its writer means.

    Args:
        text: The formula, or statements with definitions of which the last is the formula.
        dt: Sampling period [s].

    Raises:
        FormulaError: With line, column, the line itself and a mark below the place.
    """
    if not isinstance(text, str):
        raise FormulaError(f"a formula is text, not {type(text).__name__}")
    period = Period.of(dt)
    trees = _statements(text)
    try:
        definitions = Definitions(text, trees)
        node = Reader(text, period, definitions, _words(trees)).read()
        deep = f.depth(node) > MAX_DEPTH
    except RecursionError:
        deep = True
    if deep:
        raise FormulaError(
            f"the formula is nested more than {MAX_DEPTH} levels deep", "give its parts as signals"
        )
    return node, warnings.find(text, definitions, trees)


def _statements(text: str) -> list[Any]:
    from lark.exceptions import UnexpectedInput

    try:
        tree: Any = _parser().parse(blank_out(text))
    except UnexpectedInput as error:
        raise explain(text, error) from None
    except Unclear as error:
        raise complain(text, error.token, error.message, error.hint) from None
    return list(tree.children)


def _words(trees: list[Any]) -> set[str]:
    tokens = (token for tree in trees for part in tree.iter_subtrees() for token in part.children)
    return {str(token) for token in tokens if not hasattr(token, "data")}


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
