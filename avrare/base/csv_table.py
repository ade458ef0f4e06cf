"""CSV reader: header and cells of a file, with every mistake reported by line and column."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError


@dataclass(frozen=True)
class CsvTable:
    """A CSV file as text.

    Attributes:
        path: Path of the file, as the user wrote it.
        header_line: Line number of the header.
        names: Names of the columns.
        rows: (line number, cells) of each row.
    """

    path: str
    header_line: int
    names: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]

    @property
    def header(self) -> str:
        """Position of the header for messages, ``FILE:LINE``."""
        return f"{self.path}:{self.header_line}"

    def position(self, row: int, name: str) -> str:
        """Return the position of a cell for messages, ``FILE:LINE: COLUMN``."""
        return f"{self.path}:{self.rows[row][0]}: {name}"

    def cell(self, row: int, name: str) -> str:
        """Return the text of a cell, stripped."""
        return self.rows[row][1][self.names.index(name)]

    def check_rows(self) -> None:
        """Check that there are rows, all as long as the header.

        Raises:
            UsageError: There are none, or a row has another length.
        """
        for line, cells in self.rows:
            if len(cells) != len(self.names):
                raise UsageError(
                    f"{self.path}:{line}: {len(cells)} values, but the header has {len(self.names)} columns"
                )
        if not self.rows:
            raise UsageError(f"{self.path}: there are no rows below the header")

    def parse(self, row: int, name: str) -> float:
        """Return the number in a cell, NaN where the cell is empty.

        Raises:
            UsageError: The cell holds something else.
        """
        return self._parse(row, self.names.index(name))

    def parse_column(self, name: str) -> NDArray[np.float64]:
        """Return a column (n,) as numbers, NaN where the cell is empty.

        Raises:
            UsageError: A cell holds something else.
        """
        column = self.names.index(name)
        return np.array([self._parse(row, column) for row in range(len(self.rows))], dtype=np.float64)

    def number(self, row: int, name: str) -> float:
        """Return the number in a cell, which may be infinite but not NaN.

        Raises:
            UsageError: The cell is empty or holds something else.
        """
        value = self.parse(row, name)
        if not math.isnan(value):
            return value
        where = self.position(row, name)
        if not self.cell(row, name):
            raise UsageError(f"{where}: should be a number, the cell is empty")
        raise UsageError(f"{where}: NaN is not a valid sample", "leave out what was not recorded")

    def finite(self, row: int, name: str) -> float:
        """Return the finite number in a cell.

        Raises:
            UsageError: The cell is empty or holds something else.
        """
        value = self.number(row, name)
        if math.isinf(value):
            raise UsageError(f"{self.position(row, name)}: should be finite, found {value}")
        return value

    def _parse(self, row: int, column: int) -> float:
        text = self.rows[row][1][column]
        if not text:
            return math.nan
        try:
            return float(text.replace("_", "?"))  # Python would accept 1_000
        except ValueError:
            where = self.position(row, self.names[column])
            raise UsageError(f"{where}: should be a number, found {text!r}") from None


def read_csv_table(path: str | Path, *, missing: str | None = None, empty: str | None = None) -> CsvTable:
    """Read a CSV file: commas, a header line, UTF-8 with or without a byte order mark.

    Blank lines are skipped.

    Args:
        path: The file.
        missing: Hint if there is no such file.
        empty: Hint if the file is empty.

    Raises:
        UsageError: The file cannot be read, is not CSV, or is empty.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            lines = []
            try:
                for row in reader:
                    cells = tuple(cell.strip() for cell in row)
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
