"""Tables of plain dicts, and answers that contain one; both can print themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from avrare.base.errors import UsageError

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN = 60
"""Rows that are printed; the others are only counted."""


class Records(list[dict[str, Any]]):
    """List of dicts with the same keys.

    ``json.dumps``, ``csv.DictWriter`` and ``pandas.DataFrame`` take it as it is.
    """

    def __init__(self, rows: Iterable[Mapping[str, object]]) -> None:
        super().__init__(dict(row) for row in rows)

    def head(self, rows: int = 5) -> Records:
        """Return the first rows."""
        return Records(self[:rows])

    def frame(self) -> DataFrame:
        """Return a ``pandas.DataFrame``.

        Raises:
            UsageError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise UsageError("a DataFrame needs pandas", "pip install pandas; the rows are dicts") from None
        return pandas.DataFrame(list(self))

    def __repr__(self) -> str:
        if not self:
            return "(no rows)"
        rows = [list(self[0]), *(list(map(_format, row.values())) for row in self[:_SHOWN])]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return "\n".join([*lines, *self._rest()])

    def _repr_html_(self) -> str:
        if not self:
            return "<p>no rows</p>"
        head = "".join(f"<th>{escape(name)}</th>" for name in self[0])
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(_format(value))}</td>" for value in row.values()) + "</tr>"
            for row in self[:_SHOWN]
        )
        rest = "".join(f"<p>{line}</p>" for line in self._rest())
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{rest}"

    def _rest(self) -> list[str]:
        return [f"... {len(self) - _SHOWN} more rows"] if len(self) > _SHOWN else []


class Answer(ABC):
    """Value that prints itself as its command does, shows itself in a notebook, and has a table."""

    @abstractmethod
    def lines(self) -> list[str]:
        """Return a one-line description."""

    @abstractmethod
    def table(self) -> Records:
        """Return its numbers as rows; ``.frame()`` of it is a DataFrame."""

    def __repr__(self) -> str:
        return "\n".join(self.lines())

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>{self.table()._repr_html_()}"


def _format(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_format, value))
    return "" if value is None else str(value)
