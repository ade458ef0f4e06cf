"""Errors in a formula's text: where, what, and what to write instead."""

from __future__ import annotations

import difflib
import re
from typing import Any

from avrare.errors import FormulaError
from avrare.logic.tokens import FUNCTIONS, WORDS

_NAMES = {
    "RPAR": "a closing parenthesis",
    "RSQB": "a closing bracket",
    "COLON": "a colon",
    "IN": "'in'",
    "LPAR": "an opening parenthesis",
    "LSQB": "an opening bracket",
}
_BOUNDS_HINT = "bounds look like [0,3], [0:3s], [0:inf] or [0:3 samples]"
_CHARACTER_HINTS = {"=": "write == to compare", "^": "power is pow(x, 2)", "{": _BOUNDS_HINT}
_OPERAND = {"NAME", "NUMBER", "LPAR"}


def complain(text: str, place: Any, message: str, hint: str | None = None) -> FormulaError:
    """The error, pointing at ``place``: anything with ``line`` and ``column``, counted from 1."""
    line, column = place.line, place.column
    shown = text.split("\n")[line - 1].expandtabs(1).rstrip("\r")
    mark = " " * (column - 1) + "^"
    return FormulaError(f"line {line}, column {column}: {message}\n  {shown}\n  {mark}", hint)


def explain(text: str, error: Any) -> FormulaError:
    """The error that lark's exception stands for."""
    if not hasattr(error, "token"):
        character = text[error.pos_in_stream]
        return complain(text, error, f"{character!r} means nothing here", _CHARACTER_HINTS.get(character))
    token = error.token
    if token.type == "$END":
        return complain(text, _End(text), f"the formula ends early: {_expected(error)}", _misspelt(text))
    before = text[: token.start_pos]
    message = f"{str(token)!r} does not fit here: {_expected(error)}"
    return complain(text, token, message, _hint(before, token))


class _End:
    """The place just after the last character that is not blank."""

    def __init__(self, text: str) -> None:
        lines = text.rstrip().split("\n")
        self.line = len(lines)
        self.column = len(lines[-1].expandtabs(1)) + 1


def _expected(error: Any) -> str:
    accepted = set(error.accepts or error.expected)
    if accepted >= _OPERAND:
        return "an operand is missing"
    named = [name for kind, name in _NAMES.items() if kind in accepted]
    if "INFINITY" in accepted:
        named = ["a bound"]
    elif accepted & {"UNIT", "AND"} and not named:
        named = ["an operator"] if "AND" in accepted else ["a unit"]
    elif accepted == {"NAME"}:
        named = ["a name"]
    return f"{' or '.join(named) or 'an operator or the end'} is expected"


def _hint(before: str, token: Any) -> str | None:
    if token.type == "QUANTIFIER":
        return f"put '{token} ...' in parentheses"
    if token.type == "INFINITY":
        return "inf is only a bound"
    if re.search(r"\[[^\]]*$", before):
        return _BOUNDS_HINT
    if token.type == "LSQB":
        return _misspelt(before) or "only temporal operators take bounds"
    return _misspelt(before + str(token)) or _misspelt(before)


def _misspelt(text: str) -> str | None:
    """A hint if the last word of ``text`` looks like an operator."""
    last = re.search(r"([^\W\d]\w{2,})\s*$", text)
    if not last or last[1] in WORDS or last[1] in FUNCTIONS:
        return None
    close = difflib.get_close_matches(last[1].lower(), [*WORDS, *FUNCTIONS], n=1, cutoff=0.7)
    return f"did you mean {close[0]!r}?" if close else None
