"""Places in a formula's text, and errors that point at them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from avrare.base.errors import FormulaError

if TYPE_CHECKING:
    from lark import Token
    from lark.exceptions import UnexpectedInput
    from lark.tree import Meta


class Position(NamedTuple):
    """Line and column of a text, from 1."""

    line: int
    column: int


Place: TypeAlias = "Token | Meta | UnexpectedInput | Position"


class PlacedError(FormulaError):
    """Error at a place of a formula's text."""

    def __init__(self, place: Place, message: str, hint: str | None = None) -> None:
        super().__init__(message, hint)
        self.place = place

    def locate(self, text: str) -> FormulaError:
        """Return the error with its place and the source line in the message."""
        return FormulaError(add_place(text, self.place, self.message), self.hint)


def add_place(text: str, place: Place, message: str) -> str:
    """Return the message with line and column (from 1) of a place, its source line and a mark."""
    line, column = find_position(place)
    source_line = text.split("\n")[line - 1].expandtabs(1).rstrip("\r")
    mark = " " * (column - 1) + "^"
    return f"line {line}, column {column}: {message}\n  {source_line}\n  {mark}"


def find_position(place: Place) -> Position:
    """Return line and column of a place, by default the first ones."""
    return Position(place.line or 1, place.column or 1)
