"""Which words of a formula are operators and which are signals.

Long words (``always``, ``until``, ``and``, ...) are reserved. One-letter operators are operators only where
one makes sense: ``G`` where an operand follows, ``U`` after an operand; elsewhere they are signals, as in
``G > 0``. Units mean something only inside bounds, functions only before a parenthesis.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from avrare.errors import FormulaError

if TYPE_CHECKING:
    from lark import Token

WORDS = {
    "always": "WINDOW", "globally": "WINDOW", "eventually": "WINDOW", "finally": "WINDOW",
    "historically": "WINDOW", "once": "WINDOW", "next": "STEP", "prev": "STEP", "s_next": "STEP",
    "s_prev": "STEP", "until": "UNTIL", "since": "SINCE", "unless": "UNLESS", "not": "NOT", "and": "AND",
    "or": "OR", "implies": "IMPLIES", "iff": "IFF", "xor": "XOR", "true": "TRUTH", "false": "TRUTH",
    "forall": "QUANTIFIER", "exists": "QUANTIFIER", "inf": "INFINITY",
}  # fmt: skip
PREFIX_LETTERS = {
    "G": "WINDOW", "F": "WINDOW", "H": "WINDOW", "O": "WINDOW", "X": "STEP", "Y": "STEP", "sX": "STEP",
    "sY": "STEP",
}  # fmt: skip
INFIX_LETTERS = {"U": "UNTIL", "S": "SINCE", "W": "UNLESS"}
FUNCTIONS = {
    "abs": "FUNCTION", "sqrt": "FUNCTION", "exp": "FUNCTION", "log": "FUNCTION", "ln": "FUNCTION",
    "min": "FUNCTION", "max": "FUNCTION", "pow": "FUNCTION", "rise": "EDGE", "fall": "EDGE",
}  # fmt: skip
MEANING = {
    "G": "always", "globally": "always", "[]": "always", "F": "eventually", "finally": "eventually",
    "<>": "eventually", "H": "historically", "O": "once", "X": "next", "Y": "prev", "sX": "s_next",
    "sY": "s_prev", "U": "until", "S": "since", "W": "unless", "&": "and", "&&": "and", "|": "or", "||": "or",
    "->": "implies", "<->": "iff", "!==": "!=", "ln": "log",
}  # fmt: skip
UNITS = ("s", "ms", "us", "ns", "sample", "samples")

_ENDS_OPERAND = {"NAME", "NUMBER", "TRUTH", "RPAR"}
_STARTS_OPERAND = {"NAME", "NUMBER", "LPAR", "LSQB", "NOT", "WINDOW"}
_NO_OPERAND = {"and", "or", "implies", "iff", "xor", "until", "since", "unless", "inf", *INFIX_LETTERS}


class Words:
    """Gives each word its kind; stands between lark's lexer and its parser."""

    always_accept = ()

    def process(self, stream: Iterable[Token]) -> Iterator[Token]:
        """The tokens, with words retyped.

        Raises:
            FormulaError: A one-letter operator before a minus may be a signal as well.
        """
        tokens: list[Any] = list(stream)
        in_bounds = False
        before = ""
        for i, token in enumerate(tokens):
            if token.type == "NAME":
                token.type = _bound_kind(token) if in_bounds else _kind(tokens, i, before)
            in_bounds = (in_bounds or token.type == "LSQB") and token.type != "RSQB"
            before = token.type
            yield token


def _bound_kind(token: Token) -> str:
    return "INFINITY" if token == "inf" else "UNIT" if token in UNITS else "NAME"


def _kind(tokens: Sequence[Token], i: int, before: str) -> str:
    word = str(tokens[i])
    after = tokens[i + 1] if i + 1 < len(tokens) else None
    if word in WORDS:
        return WORDS[word]
    if word in FUNCTIONS:
        return FUNCTIONS[word] if after is not None and after.type == "LPAR" else "NAME"
    if word == "in" and i >= 2 and tokens[i - 2].type == "QUANTIFIER":
        return "IN"
    ends_operand = before in _ENDS_OPERAND
    if word in INFIX_LETTERS and ends_operand:
        return INFIX_LETTERS[word]
    if word in PREFIX_LETTERS and not ends_operand and _has_operand(tokens[i], after):
        return PREFIX_LETTERS[word]
    return "NAME"


def _has_operand(letter: Token, after: Token | None) -> bool:
    if after is None:
        return False
    if after.type == "MINUS":
        raise Ambiguous(letter, MEANING[str(letter)])
    return after.type in _STARTS_OPERAND and str(after) not in _NO_OPERAND


class Ambiguous(FormulaError):
    """A one-letter operator before a minus: ``G - 1 > 0``."""

    def __init__(self, token: Token, meaning: str) -> None:
        super().__init__(f"{token} may be a signal or the operator {meaning!r}")
        self.token = token
        self.hint = f"write ({token}) for the signal, or {meaning!r}, or put the operand in parentheses"
