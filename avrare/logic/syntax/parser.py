"""Parser: rtamt's syntax, with rational time bounds and errors that point at their place."""

from __future__ import annotations

import functools
import re
from fractions import Fraction
from typing import TYPE_CHECKING

from avrare.base.errors import FormulaError
from avrare.logic.syntax import nodes
from avrare.logic.syntax.definitions import Definitions
from avrare.logic.syntax.lint import LintWarning, find_lint_warnings
from avrare.logic.syntax.places import PlacedError
from avrare.logic.syntax.syntax_errors import translate_error
from avrare.logic.syntax.token_classes import INFIX_LETTERS, WORDS, TokenClassifier
from avrare.logic.syntax.transformer import FormulaTransformer

if TYPE_CHECKING:
    from lark import Lark, Token, Tree

MAX_DEPTH = 100
"""Deeper nesting is refused, as evaluation is recursive."""


_NAME = r"[^\W\d][\w.]*"


def parse(text: str, dt: float | Fraction = 1.0) -> nodes.Node:
    """Parse a formula; see ``parse_with_warnings``."""
    return parse_with_warnings(text, dt)[0]


def parse_with_warnings(text: str, dt: float | Fraction = 1.0) -> tuple[nodes.Node, tuple[LintWarning, ...]]:
    """Parse a formula and lint its text.

    Results are cached: a process parses the same text with the same period once.

    Args:
        text: Formula, or statements with definitions, the last of which is the formula.
        dt: Sampling period [s].

    Raises:
        FormulaError: The text is not a formula, or ``dt`` is invalid.
    """
    if not isinstance(text, str):
        raise FormulaError(f"a formula must be text, not {type(text).__name__}")
    longest = 200_000  # reading more takes seconds and much memory
    if len(text) > longest:
        message = f"the formula has {len(text):,} characters, more than {longest:,}"
        raise FormulaError(message, "compute parts of the formula as signals of the system")
    return _parse(text, _read_period(dt))


@functools.lru_cache(maxsize=256)
def _parse(text: str, period: Fraction) -> tuple[nodes.Node, tuple[LintWarning, ...]]:
    from lark.exceptions import UnexpectedInput

    try:
        document = _lark_parser().parse(_blank_declarations(text))
        trees = [statement for statement in document.children if not isinstance(statement, str)]
        definitions = Definitions(trees)
        node = FormulaTransformer(period, definitions, _words(trees)).transform()
        too_deep = nodes.nesting_depth(node) > MAX_DEPTH
    except UnexpectedInput as error:
        raise translate_error(text, error).locate(text) from None
    except PlacedError as error:
        raise error.locate(text) from None
    except RecursionError:
        too_deep = True
    if too_deep:
        message = f"the formula is nested more than {MAX_DEPTH} levels deep"
        hint = (
            "a chain a and b and c nests too: group it in brackets, (a and b) and (c and d), make several "
            "specifications of it, or compute parts of it as signals of the system"
        )
        raise FormulaError(message, hint)
    return node, find_lint_warnings(text, definitions, trees)


def _read_period(dt: object) -> Fraction:
    # The rational number that its decimal text denotes: 0.1 is a tenth.
    try:
        period = dt if isinstance(dt, Fraction) else Fraction(str(dt))
    except (ValueError, ZeroDivisionError):
        period = Fraction(0)
    if period <= 0 or isinstance(dt, bool | str):
        raise FormulaError(f"dt is {dt!r}", "the sampling period must be a number of seconds above zero")
    return period


def _blank_declarations(text: str) -> str:
    types_of_c = ("float", "double", "real", "int", "long", "bool", "complex", "float32", "float64")
    importing = rf"from\s+{_NAME}\s+import\s+({_NAME})"
    # rtamt's ``float x``, ``input float x``, ``output T y``, ``specification name``, ``from m import T`` and
    # ``@topic(x, name)`` are blanked, so that every place in the text stays where it is; of
    # ``const float c = 3.0`` the definition ``c = 3.0`` remains.
    types = "|".join((*types_of_c, *(re.escape(name) for name in re.findall(importing, text))))
    reserved = "|".join(sorted({*WORDS, *INFIX_LETTERS}))
    other = rf"(?!(?:{reserved})\b){_NAME}"
    declarations = (
        rf"specification[ \t]+{other}",
        rf"(?:from[ \t]+{_NAME}[ \t]+)?import[ \t]+{_NAME}",
        rf"@[ \t]*topic[ \t]*\([ \t]*{_NAME}[ \t]*,[^()\n]*\)",
        rf"(?:input|output|internal)[ \t]+{_NAME}[ \t]+{other}",
        rf"(?:{types})[ \t]+{other}",
    )
    end = r"(?=[ \t]*(?:;|\r?\n|#|//|/\*|\Z))"
    start = r"(?<![^\n;])([ \t]*)"
    text = re.sub(rf"{start}(?:{'|'.join(declarations)}){end}", _blanks, text)
    return re.sub(rf"{start}const[ \t]+{_NAME}(?=[ \t]+{_NAME}[ \t]*=(?!=))", _blanks, text)


def _blanks(match: re.Match[str]) -> str:
    return " " * len(match[0])


def _words(trees: list[Tree[Token]]) -> set[str]:
    tokens = (token for tree in trees for part in tree.iter_subtrees() for token in part.children)
    return {str(token) for token in tokens if isinstance(token, str)}


@functools.cache
def _lark_parser() -> Lark:
    from lark import Lark

    return Lark.open(
        "grammar.lark",
        rel_to=__file__,
        parser="lalr",
        lexer="basic",
        postlex=TokenClassifier(),
        propagate_positions=True,
    )
