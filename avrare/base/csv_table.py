"""CSV reader: header and cells of a file, with every mistake reported by line and column."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.visible_text import spell_controls


@dataclass(frozen=True)
class CsvTable:
    """A CSV file as text; cells of another type raise a ``UsageError``."""

    path: str  # as the user wrote it
    header_line: int
    names: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]  # line number and cells of each

    @property
    def header(self) -> str:
        """Position of the header for messages, ``FILE:LINE``."""
        return f"{self.path}:{self.header_line}"

    def position(self, row: int, name: str) -> str:
        """Return the position of a cell for messages, ``FILE:LINE: COLUMN``."""
        return f"{self.path}:{self.rows[row][0]}: {name}"

    def cell(self, row: int, name: str) -> str:
        """Return the text of a cell, stripped and with control characters spelt out."""
        return self.rows[row][1][self.names.index(name)]

    def check_rows(self) -> None:
        """Check that there are rows, all as long as the header."""
        for line, cells in self.rows:
            if len(cells) != len(self.names):
                raise UsageError(
                    f"{self.path}:{line}: {len(cells)} values, but the header has {len(self.names)} columns",
                    "each line needs a value for every column of the first line, between commas",
                )
        if not self.rows:
            raise UsageError(f"{self.path}: there are no rows below the header")

    def parse(self, row: int, name: str) -> float:
        """Return the number in a cell, NaN where the cell is empty."""
        text = self.cell(row, name)
        if not text:
            return math.nan
        try:
            return float(text.replace("_", "?"))  # Python would accept 1_000
        except ValueError:
            raise UsageError(f"{self.position(row, name)}: should be a number, found {text!r}") from None

    def parse_column(self, name: str) -> NDArray[np.float64]:
        """Return a column (n,) as numbers, NaN where the cell is empty."""
        return np.array([self.parse(row, name) for row in range(len(self.rows))], dtype=np.float64)

    def number(self, row: int, name: str) -> float:
        """Return the number in a cell, which may be infinite but not NaN."""
        value = self.parse(row, name)
        if not math.isnan(value):
            return value
        where = self.position(row, name)
        if not self.cell(row, name):
            raise UsageError(f"{where}: should be a number, the cell is empty")
        raise UsageError(f"{where}: NaN is not a valid sample", "leave out what was not recorded")

    def finite(self, row: int, name: str) -> float:
        """Return the finite number in a cell."""
        value = self.number(row, name)
        if math.isinf(value):
            raise UsageError(f"{self.position(row, name)}: should be finite, found {value}")
        return value


def read_csv_table(path: str | Path, *, missing: str | None = None, empty: str | None = None) -> CsvTable:
    """Read a CSV file: commas, a header line, UTF-8 with or without a byte order mark; skip blank lines.

    ``missing`` and ``empty`` are hints for a file that does not exist or holds nothing.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            lines = []
            try:
                for row in reader:
                    cells = tuple(spell_controls(cell.strip()).replace("\n", "\\x0a") for cell in row)
                    if any(cells):
                        lines.append((reader.line_num, cells))
            except csv.Error as error:
                raise UsageError(f"{path}:{reader.line_num}: not CSV: {error}") from None
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file", missing) from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not UTF-8 text", "save it as CSV in UTF-8") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    if not lines:
        raise UsageError(f"{path}:1: the file is empty", empty)
    (header_line, names), *rows = lines
    return CsvTable(str(path), header_line, names, tuple(rows))
