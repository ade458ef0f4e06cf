"""Token classes: separates operators from signals, and finds the end of each statement.

Long words (``always``, ``until``, ``and``, ...) are reserved. One-letter operators (and ``alw``, ``ev``) are
operators only where one makes sense: ``G`` where an operand follows, ``U`` after an operand; elsewhere they
are signals, as in ``G > 0``. Units are recognised only inside bounds, functions only before a parenthesis. A
statement ends at a semicolon, or at the end of a line whose formula is complete if the next line starts one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from avrare.logic.syntax.places import PlacedError

if TYPE_CHECKING:
    from lark import Token


def read_table(text: str) -> dict[str, str]:
    """Return the first word of each entry, by the words that follow it; entries end at semicolons."""
    return {word: name for name, *words in map(str.split, text.split(";")) for word in words}


WORDS = read_table(
    "WINDOW always globally eventually finally historically once; STEP next prev s_next s_prev;"
    "UNTIL until; SINCE since; UNLESS unless; NOT not; AND and; OR or; IMPLIES implies; IFF iff; XOR xor;"
    "TRUTH true false; QUANTIFIER forall exists; COUNTED at_least; INFINITY inf"
)
PREFIX_LETTERS = read_table("WINDOW G F H O alw alw_ ev ev_; STEP X Y sX sY")
INFIX_LETTERS = read_table("UNTIL U until_; SINCE S; UNLESS W")
FUNCTIONS = read_table("FUNCTION abs sqrt exp log ln min max pow; EDGE rise fall")
MEANING = read_table(
    "always G globally alw alw_ []; eventually F finally ev ev_ <>; historically H; once O; next X; prev Y;"
    "s_next sX; s_prev sY; until U until_; since S; unless W; not ! ~; and & &&; or | ||; implies ->;"
    "iff <->; != !==; log ln"
)
UNITS = ("s", "ms", "us", "ns", "sample", "samples")

_ENDS_OPERAND = {"NAME", "NUMBER", "TRUTH", "RPAR"}
_STARTS_OPERAND = {"NAME", "NUMBER", "LPAR", "LSQB", "LBRACE", "NOT", "WINDOW"}
_STARTS_STATEMENT = _STARTS_OPERAND - {"LSQB", "LBRACE"} | {"TRUTH", "FUNCTION", "EDGE", "STEP"}
_STARTS_STATEMENT |= {"QUANTIFIER", "COUNTED"}
_NO_OPERAND = {"and", "or", "implies", "iff", "xor", "until", "since", "unless", "inf", *INFIX_LETTERS}


class TokenClassifier:
    """Stage between lark's lexer and parser that classifies words and ends statements."""

    always_accept = ("SEMICOLON", "LBRACE", "RBRACE")

    def process(self, stream: Iterable[Token]) -> Iterator[Token]:
        """Return the tokens, with words and braces retyped and ``_END`` between statements."""
        return _TokenPass(list(stream)).tokens()


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
            if self.open and self.open[-1].type == "LSQB":
                token.type = "INFINITY" if token == "inf" else "UNIT" if token in UNITS else "NAME"
            else:
                token.type = _kind(self.all, i, complete, new_line)
        elif token.type in {"LPAR", "LSQB", "LBRACE"}:
            if token.type == "LBRACE":
                token.type = "LSQB" if self._opens_bounds(i) else "LPAR"
            self.open.append(token)
        elif token.type in {"RPAR", "RSQB", "RBRACE"}:
            self._close(token)
        elif token.type == "MINUS" and new_line and self.defining:
            hint = "end the line above with the minus, or put this line's formula in parentheses"
            raise PlacedError(token, "the minus may continue the line above or start a formula", hint)
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
            raise PlacedError(token, message, "close it with the same kind of bracket")
        if token.type == "RBRACE":
            token.type = "RSQB" if opening is not None and opening.type == "LSQB" else "RPAR"


def _kind(tokens: Sequence[Token], i: int, complete: bool, new_line: bool) -> str:
    word, types = str(tokens[i]), [token.type for token in tokens[max(0, i - 3) : i]]
    after = tokens[i + 1] if i + 1 < len(tokens) else None
    if word in WORDS:
        return WORDS[word]
    if word in FUNCTIONS:
        return FUNCTIONS[word] if after is not None and after.type == "LPAR" else "NAME"
    # of a quantifier: ``forall o in``, ``at_least 3 o in``
    if word == "in" and ("QUANTIFIER" in types[-2:-1] or "COUNTED" in types[-3:-2]):
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
        raise PlacedError(letter, f"{letter} may be a signal or the operator {meaning!r}", hint)
    return _starts_operand(after)


def _starts_operand(after: Token | None) -> bool:
    return after is not None and after.type in _STARTS_OPERAND and str(after) not in _NO_OPERAND
