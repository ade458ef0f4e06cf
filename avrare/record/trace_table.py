"""CSV files of numbers over time, with every mistake named by its line."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats

_JITTER = 0.05
"""Share of a step by which a sample may be early or late."""


@dataclass(frozen=True)
class Table:
    """A CSV file as text.

    Attributes:
        path: Of the file, as the user wrote it.
        names: Of the columns.
        rows: (line in the file, cells).
    """

    path: str
    names: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]

    @property
    def time(self) -> str:
        """Name of the column with the time [s].

        Raises:
            UsageError: There is none.
        """
        for name in ("time", "t"):
            if name in self.names:
                return name
        raise UsageError(
            f"{self.path}:1: there is no column 'time' or 't'",
            f"give every row its time in seconds; the columns are {', '.join(self.names)}",
        )

    def number(self, row: int, name: str) -> float:
        """The number in a cell; infinity is one, NaN is not.

        Raises:
            UsageError: The cell holds something else.
        """
        line, cells = self.rows[row]
        text = cells[self.names.index(name)]
        try:
            value = float(text.replace("_", "?"))
        except ValueError:
            found = f"found {text!r}" if text else "the cell is empty"
            raise UsageError(f"{self.path}:{line}: {name}: should be a number, {found}") from None
        if math.isnan(value):
            raise UsageError(
                f"{self.path}:{line}: {name}: NaN is no sample", "leave out what was not recorded"
            )
        return value

    def finite(self, row: int, name: str) -> float:
        """The finite number in a cell.

        Raises:
            UsageError: The cell holds something else.
        """
        value = self.number(row, name)
        if math.isinf(value):
            raise UsageError(f"{self.path}:{self.rows[row][0]}: {name}: should be finite, found {value}")
        return value

    def numbers(self, name: str) -> Floats:
        """A whole column."""
        return np.array([self.number(row, name) for row in range(len(self.rows))])


def read_table(path: str) -> Table:
    """Read a CSV file: commas, a header line, UTF-8 with or without a byte order mark.

    Raises:
        UsageError: The file cannot be read or is no table.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            try:
                lines = [(reader.line_num, tuple(cell.strip() for cell in row)) for row in reader if any(row)]
            except csv.Error as error:
                raise UsageError(f"{path}:{reader.line_num}: not CSV: {error}") from None
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not UTF-8 text", "save it as CSV in UTF-8") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    if not lines:
        raise UsageError(f"{path}:1: the file is empty", "the first line names the columns: time,speed,gap")
    _check_header(path, *lines[0])
    names = lines[0][1]
    for line, cells in lines[1:]:
        if len(cells) != len(names):
            raise UsageError(f"{path}:{line}: {len(cells)} values, but the header has {len(names)} columns")
    if len(lines) == 1:
        raise UsageError(f"{path}: there are no rows below the header")
    return Table(path, names, tuple(lines[1:]))


def _check_header(path: str, line: int, names: Sequence[str]) -> None:
    for sign, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(names) == 1 and sign in names[0]:
            raise UsageError(
                f"{path}:{line}: the columns are separated by {word}",
                "separate them by commas, with a point in decimal numbers",
            )
    for place, name in enumerate(names):
        if not name:
            raise UsageError(f"{path}:{line}: column {place + 1} has no name")
        if name in names[:place]:
            raise UsageError(f"{path}:{line}: two columns are called {name!r}")


def steady_step(table: Table, times: Floats, rows: Sequence[int]) -> float:
    """The step [s] between samples.

    Args:
        table: For messages.
        times: (T,) of the samples, in the file's order [s].
        rows: Their rows in the table.

    Raises:
        UsageError: There are fewer than two samples, or their times do not rise evenly.
    """
    if len(times) < 2:
        raise UsageError(f"{table.path}: there is only one sample", "the step is the time between samples")
    steps = np.diff(times)
    usual = float(np.quantile(steps, 0.5, method="lower"))  # a gap is larger than a step
    wrong = np.flatnonzero(steps <= 0.0)
    if not len(wrong):
        wrong = np.flatnonzero(np.abs(steps - usual) > _JITTER * usual)
    if len(wrong):
        k = int(wrong[0])
        line, before = (table.rows[rows[i]][0] for i in (k + 1, k))
        where = f"{table.path}:{line}: {table.time}"
        if steps[k] == 0.0:
            raise UsageError(f"{where}: {times[k]:g} s a second time", f"it is already on line {before}")
        if steps[k] < 0.0:
            raise UsageError(f"{where}: goes back from {times[k]:g} s to {times[k + 1]:g} s", "sort by time")
        raise UsageError(
            f"{where}: {times[k + 1]:g} s is {steps[k]:.4g} s after the sample before, others {usual:.4g} s",
            "a trace has one step throughout: resample it, or cut it in two",
        )
    return round(float(times[-1] - times[0]) / len(steps), 9)
