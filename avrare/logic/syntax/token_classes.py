"""Token classes: separates operators from signals, and finds the end of each statement.

Long words (``always``, ``until``, ``and``, ...) are reserved. One-letter operators (and ``alw``, ``ev``) are
operators only where one makes sense: ``G`` where an operand follows, ``U`` after an operand; elsewhere they
are signals, as in ``G > 0``. Units are recognised only inside bounds, functions only before a parenthesis. A
statement ends at a semicolon, or at the end of a line whose formula is complete if the next line starts one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from avrare.base.errors import FormulaError

if TYPE_CHECKING:
    from lark import Token

WORDS = {
    "always": "WINDOW", "globally": "WINDOW", "eventually": "WINDOW", "finally": "WINDOW",
    "historically": "WINDOW", "once": "WINDOW", "next": "STEP", "prev": "STEP", "s_next": "STEP",
    "s_prev": "STEP", "until": "UNTIL", "since": "SINCE", "unless": "UNLESS", "not": "NOT", "and": "AND",
    "or": "OR", "implies": "IMPLIES", "iff": "IFF", "xor": "XOR", "true": "TRUTH", "false": "TRUTH",
    "forall": "QUANTIFIER", "exists": "QUANTIFIER", "at_least": "COUNTED",
    "inf": "INFINITY",
}  # fmt: skip
PREFIX_LETTERS = {
    "G": "WINDOW", "F": "WINDOW", "H": "WINDOW", "O": "WINDOW", "X": "STEP", "Y": "STEP", "sX": "STEP",
    "sY": "STEP", "alw": "WINDOW", "alw_": "WINDOW", "ev": "WINDOW", "ev_": "WINDOW",
}  # fmt: skip
INFIX_LETTERS = {"U": "UNTIL", "S": "SINCE", "W": "UNLESS", "until_": "UNTIL"}
FUNCTIONS = {
    "abs": "FUNCTION",
    "sqrt": "FUNCTION",
    "exp": "FUNCTION",
    "log": "FUNCTION",
    "ln": "FUNCTION",
    "min": "FUNCTION",
    "max": "FUNCTION",
    "pow": "FUNCTION",
    "rise": "EDGE",
    "fall": "EDGE",
}
MEANING = {
    "G": "always", "globally": "always", "alw": "always", "alw_": "always", "[]": "always", "[ ]": "always",
    "F": "eventually", "finally": "eventually", "ev": "eventually", "ev_": "eventually", "<>": "eventually",
    "< >": "eventually", "H": "historically", "O": "once", "X": "next", "Y": "prev", "sX": "s_next",
    "sY": "s_prev", "U": "until", "until_": "until", "S": "since", "W": "unless", "!": "not", "~": "not",
    "&": "and", "&&": "and", "|": "or", "||": "or", "->": "implies", "<->": "iff", "!==": "!=", "ln": "log",
}  # fmt: skip
UNITS = ("s", "ms", "us", "ns", "sample", "samples")

_ENDS_OPERAND = {"NAME", "NUMBER", "TRUTH", "RPAR"}
_STARTS_OPERAND = {"NAME", "NUMBER", "LPAR", "LSQB", "LBRACE", "NOT", "WINDOW"}
_STARTS_STATEMENT = {
    "NAME", "NUMBER", "LPAR", "TRUTH", "FUNCTION", "EDGE", "NOT", "WINDOW", "STEP", "QUANTIFIER", "COUNTED",
}  # fmt: skip
_NO_OPERAND = {"and", "or", "implies", "iff", "xor", "until", "since", "unless", "inf", *INFIX_LETTERS}


class TokenError(FormulaError):
    """Ambiguous token, or bracket that closes another kind of bracket."""

    def __init__(self, token: Token, message: str, hint: str) -> None:
        super().__init__(message, hint)
        self.token = token


class TokenClassifier:
    """Stage between lark's lexer and parser that classifies words and ends statements."""

    always_accept = ("SEMICOLON", "LBRACE", "RBRACE")

    def process(self, stream: Iterable[Token]) -> Iterator[Token]:
        """Return the tokens, with words and braces retyped and ``_END`` between statements."""
        return _TokenPass(_without_times(list(stream))).tokens()


def _without_times(tokens: list[Token]) -> list[Token]:
    # ``x[t] > 0`` means ``x > 0``.
    types, timed = [token.type for token in tokens], ["NAME", "LSQB", "NAME", "RSQB"]
    starts = [i for i in range(1, len(tokens)) if types[i - 1 : i + 3] == timed and tokens[i + 1] == "t"]
    dropped = {i + k for i in starts for k in range(3)}
    return [token for i, token in enumerate(tokens) if i not in dropped]


class _TokenPass:
    def __init__(self, tokens: list[Token]) -> None:
        self.all = tokens
        self.open: list[Token] = []
        self.before = ""
        self.defining = False

    def tokens(self) -> Iterator[Token]:
        ending: Token | None = None
        started = False
        for i, token in enumerate(self.all):
            if token.type == "SEMICOLON":
                ending, self.before = ending or token, ""
                continue
            new_line = self._type(i, token)
            if new_line and token.type in _STARTS_STATEMENT:
                ending = ending or type(token).new_borrow_pos("_END", str(token), token)
            if ending is not None and started:
                ending.type = "_END"
                yield ending
            if ending is not None:
                self.defining = False
            self.defining |= token.type == "EQUAL"
            counts = self.before == "COUNTED"
            ending, started, self.before = None, True, "" if counts else token.type
            yield token

    def _type(self, i: int, token: Token) -> bool:
        # The result is True if the token starts a line after a complete operand.
        complete = self.before in _ENDS_OPERAND
        new_line = complete and not self.open and (token.line or 0) > (self.all[i - 1].end_line or 0)
        if token.type == "NAME":
            in_bounds = bool(self.open) and self.open[-1].type == "LSQB"
            token.type = _bound_kind(token) if in_bounds else _kind(self.all, i, complete, new_line)
        elif token.type in {"LPAR", "LSQB", "LBRACE"}:
            if token.type == "LBRACE":
                token.type = "LSQB" if self._opens_bounds(i) else "LPAR"
            self.open.append(token)
        elif token.type in {"RPAR", "RSQB", "RBRACE"}:
            self._close(token)
        elif token.type == "MINUS" and new_line and self.defining:
            hint = "end the line above with the minus, or put this line's formula in parentheses"
            raise TokenError(token, "the minus may continue the line above or start a formula", hint)
        return new_line

    def _opens_bounds(self, i: int) -> bool:
        after = [token.type for token in self.all[i + 2 : i + 4]]
        return self.before in {"WINDOW", "UNTIL", "SINCE", "UNLESS"} and bool({"COMMA", "COLON"} & set(after))

    def _close(self, token: Token) -> None:
        opening = self.open.pop() if self.open else None
        pair = f"{opening or ''}{token}"
        if opening is not None and pair in ("{)", "{]", "(}", "[}"):
            where = f"line {opening.line}, column {opening.column}"
            message = f"'{token}' does not close the '{opening}' at {where}"
            raise TokenError(token, message, "close it with the same kind of bracket")
        if token.type == "RBRACE":
            token.type = "RSQB" if opening is not None and opening.type == "LSQB" else "RPAR"


def _bound_kind(token: Token) -> str:
    return "INFINITY" if token == "inf" else "UNIT" if token in UNITS else "NAME"


def _kind(tokens: Sequence[Token], i: int, complete: bool, new_line: bool) -> str:
    word = str(tokens[i])
    after = tokens[i + 1] if i + 1 < len(tokens) else None
    if word in WORDS:
        return WORDS[word]
    if word in FUNCTIONS:
        return FUNCTIONS[word] if after is not None and after.type == "LPAR" else "NAME"
    if word == "in" and _binds(tokens, i):
        return "IN"
    if word in INFIX_LETTERS and complete and (not new_line or _starts_operand(after)):
        return INFIX_LETTERS[word]
    if word in PREFIX_LETTERS and (new_line or not complete) and _has_operand(tokens[i], after):
        return PREFIX_LETTERS[word]
    return "NAME"


def _has_operand(letter: Token, after: Token | None) -> bool:
    if after is not None and after.type == "MINUS":
        meaning = MEANING[str(letter)]
        hint = f"write ({letter}) for the signal, or {meaning!r}, or put the operand in parentheses"
        raise TokenError(letter, f"{letter} may be a signal or the operator {meaning!r}", hint)
    return _starts_operand(after)


def _starts_operand(after: Token | None) -> bool:
    return after is not None and after.type in _STARTS_OPERAND and str(after) not in _NO_OPERAND


def _binds(tokens: Sequence[Token], i: int) -> bool:
    # ``in`` of a quantifier: ``forall o in``, ``at_least 3 o in``.
    return (i >= 2 and tokens[i - 2].type == "QUANTIFIER") or (i >= 3 and tokens[i - 3].type == "COUNTED")
