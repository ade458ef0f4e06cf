"""Errors in a formula's text: place, problem, and correction."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from avrare.logic.syntax.places import PlacedError, Position
from avrare.logic.syntax.token_classes import FUNCTIONS, WORDS, read_table

if TYPE_CHECKING:
    from lark import Token
    from lark.exceptions import UnexpectedInput, UnexpectedToken


_NAMES = {
    "RPAR": "a closing parenthesis",
    "RSQB": "a closing bracket",
    "COLON": "a colon",
    "IN": "'in'",
    "LPAR": "an opening parenthesis",
    "LSQB": "an opening bracket",
}
_CHARACTERS = read_table(
    "and ∧; or ∨; not ¬; xor ⊕; -> → ⇒; <-> ↔ ⇔; <= ≤; >= ≥; != ≠; always □; eventually ◇; - − –; * × ·; / ÷;"
    "inf ∞; forall ∀; exists ∃"
)
_CHARACTER_HINTS = {
    "^": "power is pow(x, 2), exclusive or is xor",
    "%": "comments start with # or //",
    **{character: f"write {word}" for character, word in _CHARACTERS.items()},
}
_CONTEXT = 200
"""Characters around the place of an error that hints look at."""


def translate_error(text: str, error: UnexpectedInput) -> PlacedError:
    """Translate lark's exception."""
    from lark.exceptions import UnexpectedToken

    if not isinstance(error, UnexpectedToken):
        character = text[error.pos_in_stream or 0]
        return PlacedError(error, f"unexpected character {character!r}", _CHARACTER_HINTS.get(character))
    token = error.token
    if token.type == "$END":
        message = f"the formula ends early: {_find_expected(error)}"
        place = Position(token.end_line or 1, token.end_column or 1)
        return PlacedError(place, message, _misspelt(text[: token.end_pos][-_CONTEXT:]))
    start = token.start_pos or 0
    before, rest = text[max(0, start - _CONTEXT) : start], text[start : start + _CONTEXT]
    if rest.startswith("/*") or (before.endswith("/") and rest.startswith("*")):
        return PlacedError(token, "unterminated comment", "close it with */")
    message = f"unexpected {str(token)!r}: {_find_expected(error)}"
    return PlacedError(token, message, _hint(before, rest, token))


def suggest(word: str, candidates: Iterable[str], cutoff: float = 0.7) -> str | None:
    """Return the candidate most similar to ``word``, None if no candidate is similar enough.

    Unlike ``did_you_mean`` it ignores case and never lists all names.
    """
    names = list(candidates) if len(word) < _CONTEXT else []
    alike = [name for name in names if name.lower() == word.lower()]
    close = alike or difflib.get_close_matches(word.lower(), names, n=1, cutoff=cutoff)
    return close[0] if close else None


def _find_expected(error: UnexpectedToken) -> str:
    accepted = set(error.accepts or error.expected)
    if accepted >= {"NAME", "NUMBER", "LPAR"}:
        return "an operand is missing"
    choices = [name for kind, name in _NAMES.items() if kind in accepted]
    if "INFINITY" in accepted:
        choices = ["a bound"]
    elif "AND" in accepted:
        choices = ["a closing parenthesis"] if "RPAR" in accepted else ["an operator"]
    elif "UNIT" in accepted and not choices:
        choices = ["a unit"]
    elif accepted == {"NAME"}:
        choices = ["a name"]
    elif accepted == {"NAME", "NUMBER"}:
        choices = ["a number"]
    return f"{' or '.join(choices) or 'an operator or the end'} is expected"


def _hint(before: str, rest: str, token: Token) -> str | None:
    if token.type == "INFINITY":
        return "inf can only be a bound"
    if token.type == "EQUAL":
        return _equal_hint(before)
    if token == ">" and before.endswith("="):
        return "write >= to compare, -> for implies"
    if re.search(r"\[[^\]\n]*$", before):
        return "bounds look like [0,3], [0:3s], [0:inf] or [0:3 samples]"
    if token.type == "NAME" and re.search(r"(^|[^\w.])\d[\d.]*\s*$", before):
        return "numbers have no unit, only time bounds do, as in always[0:3s]; a product is written 3 * x"
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
        return f"{word[1]!r} is a reserved word: choose another name"
    return "write == to compare"


def _misspelt(text: str) -> str | None:
    last = re.search(r"([^\W\d]\w{2,})\s*$", text)
    if not last or last[1] in WORDS or last[1] in FUNCTIONS:
        return None
    close = suggest(last[1], [*WORDS, *FUNCTIONS])
    return f"did you mean {close!r}?" if close else None
