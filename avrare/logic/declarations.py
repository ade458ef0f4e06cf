"""Lines that rtamt's specifications have and a formula does not need: names of types, imports and topics."""

from __future__ import annotations

import re

from avrare.logic.tokens import INFIX_LETTERS, WORDS

_NAME = r"[^\W\d][\w.]*"
_TYPES = ("float", "double", "real", "int", "long", "bool", "complex", "float32", "float64")
_IMPORT = rf"from\s+{_NAME}\s+import\s+({_NAME})"
_RESERVED = "|".join(sorted({*WORDS, *INFIX_LETTERS}))
_STARTS = r"(?<![^\n;])([ \t]*)"
_ENDS = r"(?=[ \t]*(?:;|\r?\n|#|//|/\*|\Z))"


def blank_out(text: str) -> str:
    """The text with its declarations replaced by blanks, so that every place in it stays where it is.

    ``float x``, ``input float x``, ``output T y``, ``specification name``, ``from m import T`` and
    ``@topic(x, name)`` go; of ``const float c = 3.0`` the definition ``c = 3.0`` stays.
    """
    types = "|".join((*_TYPES, *(re.escape(name) for name in re.findall(_IMPORT, text))))
    other = rf"(?!(?:{_RESERVED})\b){_NAME}"
    whole = (
        rf"specification[ \t]+{other}",
        rf"(?:from[ \t]+{_NAME}[ \t]+)?import[ \t]+{_NAME}",
        rf"@[ \t]*topic[ \t]*\([ \t]*{_NAME}[ \t]*,[^()\n]*\)",
        rf"(?:input|output|internal)[ \t]+{_NAME}[ \t]+{other}",
        rf"(?:{types})[ \t]+{other}",
    )
    text = re.sub(rf"{_STARTS}(?:{'|'.join(whole)}){_ENDS}", _blanks, text)
    return re.sub(rf"{_STARTS}const[ \t]+{_NAME}(?=[ \t]+{_NAME}[ \t]*=(?!=))", _blanks, text)


def _blanks(match: re.Match[str]) -> str:
    return " " * len(match[0])
