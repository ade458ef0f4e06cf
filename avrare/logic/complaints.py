"""Errors in and warnings about a formula's text: where, what, and what to write instead."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
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
_CHARACTER_HINTS = {
    "^": "power is pow(x, 2), exclusive or is xor", "∧": "write and", "∨": "write or", "¬": "write not",
    "⊕": "write xor", "→": "write ->", "⇒": "write ->", "↔": "write <->", "⇔": "write <->", "≤": "write <=",
    "≥": "write >=", "≠": "write !=", "□": "write always", "◇": "write eventually", "−": "write -",
    "–": "write -", "×": "write *", "·": "write *", "÷": "write /", "∞": "write inf", "∀": "write forall",
    "∃": "write exists", "%": "comments start with # or //",
}  # fmt: skip
_OPERAND = {"NAME", "NUMBER", "LPAR"}
_NEAR = 200
"""Characters around the place of an error that hints look at."""


@dataclass(frozen=True)
class Complaint:
    """A warning about a formula's text.

    Attributes:
        message: Place, text and mark in the layout of an error's message:
            ``line 1, column 3: what is odd``, the line itself, and a mark below the place.
        hint: What to write instead.
    """

    message: str
    hint: str | None = None


def pointed(text: str, place: Any, message: str) -> str:
    """The message with its place: anything with ``line`` and ``column``, counted from 1."""
    line, column = place.line, place.column
    shown = text.split("\n")[line - 1].expandtabs(1).rstrip("\r")
    mark = " " * (column - 1) + "^"
    return f"line {line}, column {column}: {message}\n  {shown}\n  {mark}"


def complain(text: str, place: Any, message: str, hint: str | None = None) -> FormulaError:
    """The error, pointing at ``place``."""
    return FormulaError(pointed(text, place, message), hint)


def explain(text: str, error: Any) -> FormulaError:
    """The error that lark's exception stands for."""
    if not hasattr(error, "token"):
        character = text[error.pos_in_stream]
        return complain(text, error, f"{character!r} means nothing here", _CHARACTER_HINTS.get(character))
    token = error.token
    if token.type == "$END":
        message = f"the formula ends early: {_expected(error)}"
        return complain(text, _Behind(token), message, _misspelt(text[: token.end_pos][-_NEAR:]))
    start = token.start_pos
    before, rest = text[max(0, start - _NEAR) : start], text[start : start + _NEAR]
    if rest.startswith("/*") or (before.endswith("/") and rest.startswith("*")):
        return complain(text, token, "a comment starts here and does not end", "close it with */")
    message = f"{str(token)!r} does not fit here: {_expected(error)}"
    return complain(text, token, message, _hint(before, rest, token))


def guess(word: str, known: Iterable[str], cutoff: float = 0.7) -> str | None:
    """The known name that ``word`` was most likely meant to be."""
    names = list(known) if len(word) < _NEAR else []
    alike = [name for name in names if name.lower() == word.lower()]
    close = alike or difflib.get_close_matches(word.lower(), names, n=1, cutoff=cutoff)
    return close[0] if close else None


class _Behind:
    """The place just after a token; the first place of a text without any."""

    def __init__(self, token: Any) -> None:
        self.line = token.end_line or 1
        self.column = token.end_column or 1


def _expected(error: Any) -> str:
    accepted = set(error.accepts or error.expected)
    if accepted >= _OPERAND:
        return "an operand is missing"
    named = [name for kind, name in _NAMES.items() if kind in accepted]
    if "INFINITY" in accepted:
        named = ["a bound"]
    elif "AND" in accepted:
        named = ["a closing parenthesis"] if "RPAR" in accepted else ["an operator"]
    elif "UNIT" in accepted and not named:
        named = ["a unit"]
    elif accepted == {"NAME"}:
        named = ["a name"]
    elif accepted == {"NAME", "NUMBER"}:
        named = ["a number"]
    return f"{' or '.join(named) or 'an operator or the end'} is expected"


def _hint(before: str, rest: str, token: Any) -> str | None:
    if token.type == "INFINITY":
        return "inf is only a bound"
    if token.type == "EQUAL":
        return _equal_hint(before)
    if token == ">" and before.endswith("="):
        return "write >= to compare, -> for implies"
    if re.search(r"\[[^\]\n]*$", before):
        return _BOUNDS_HINT
    if token.type == "LSQB":
        if re.search(r"\b(exists|forall)\s*$", before):
            return "write at_least 2 o in others: ... for two or more"
        return _misspelt(before) or "only temporal operators take bounds"
    if re.match(r"[^\W\d][\w.]*\s*(\([^()]*\))?\s*=[^=]", rest):
        if re.search(r"(^|[\n;])\s*((in|out)put\s+)?[^\W\d]\w*\s+$", before):
            return "only constants are declared with a value: const float x = 3.0"
        return "start a definition on a new line, or put ';' before it"
    return _misspelt(before + str(token)) or _misspelt(before)


def _equal_hint(before: str) -> str:
    word = re.search(r"(\w+)\s*(\([^()]*\)\s*)?$", before)
    if word and (word[1] in WORDS or word[1] in FUNCTIONS):
        return f"{word[1]!r} is a word of the language: choose another name"
    return "write == to compare"


def _misspelt(text: str) -> str | None:
    """A hint if the last word of ``text`` looks like an operator."""
    last = re.search(r"([^\W\d]\w{2,})\s*$", text)
    if not last or last[1] in WORDS or last[1] in FUNCTIONS:
        return None
    close = guess(last[1], [*WORDS, *FUNCTIONS])
    return f"did you mean {close!r}?" if close else None
