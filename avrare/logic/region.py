"""The samples that are not settled, and the ones to come, as things stand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.algebra import Bounds, Robustness
from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import evaluate, stack
from avrare.logic.reach import Range
from avrare.logic.temporal import Obligation, join_rows
from avrare.logic.windows import neutral

Array = NDArray[Any]


@dataclass(frozen=True)
class Tail:
    """Samples not seen yet.

    Attributes:
        count: How many there are rows for.
        common: The row that stands for many alike, counted from the first one not seen.
        common_last: The last sample that it stands for, counted alike; ``math.inf`` in an endless trace.
        length: Samples of the whole trace; None: endless.
    """

    count: int = 0
    common: int = 0
    common_last: float = 0
    length: int | None = None


def make_tail(seen: int, settling: int, horizon: int, length: int | None) -> Tail:
    """The tail of a trace of ``length`` samples of which some are seen.

    Values repeat from ``settling`` samples after the last one seen to ``horizon`` samples before the end: one
    row stands for all of them.
    """
    if length is None:
        return Tail(settling + 1, settling, math.inf)
    left, needed = length - seen, settling + 1 + horizon
    if left <= needed:
        return Tail(left, left, left, length)
    return Tail(needed, settling, left - 1 - horizon, length)


class Region:
    """Values of cells at the samples after their settled ones: (P, N, ...), or (P, 2, N, ...) as bounds.

    Args:
        now: The newest sample, all cells settled.
        obligations: The unbounded future operators, by corner axis.
        tail: Samples not seen yet; None gives nominal values, of the trace as it is.

    Attributes:
        last: The last row, counting rows as samples.
        end: The last sample; ``math.inf`` in an endless trace.
    """

    def __init__(self, now: Moment, obligations: list[Obligation], tail: Tail | None = None) -> None:
        self.now = now
        self.exact: Robustness = now.algebra
        self.bounded = tail is not None
        self.tail = tail or Tail()
        endless = math.isinf(self.tail.common_last)
        self.algebra = Bounds(now.algebra, 0, endless) if self.bounded else now.algebra
        self.lead = 3 if self.bounded else 2
        self.last = now.t + self.tail.count
        self.end = self.last + self.tail.common_last - self.tail.common
        self._obligations = obligations
        self._values: dict[int, Array] = {}

    def start(self, cell: Cell) -> int:
        """The first sample at which the cell is not settled."""
        return max(0, self.now.t - cell.delay + 1)

    def count(self, cell: Cell) -> int:
        """Samples at which the cell is not settled."""
        return self.last - self.start(cell) + 1

    def open(self, cell: Cell) -> Array:
        """The cell's values that are not settled."""
        if cell.index not in self._values:
            self._values[cell.index] = cell.open(self)
        return self._values[cell.index]

    def rows(self, cell: Cell, first: int) -> Array:
        """The cell's values from sample ``first`` on."""
        wanted = self.start(cell) - first
        if wanted <= 0:
            return self.open(cell)[-wanted:]
        settled = self.settled(cell, wanted)
        assert settled is not None
        return join_rows(settled, self.open(cell)) if self.count(cell) else settled

    def settled(self, cell: Cell, count: int) -> Array | None:
        """The cell's newest settled values, ``count`` of them; None before the first."""
        newest = self.now.tables[cell.index][-count:]
        if not newest:
            return None
        return self.collapse(stack(newest), cell, 1)

    def collapse(self, table: Array, cell: Cell, rows: int = 0) -> Array:
        """Values (rows..., corners, N, ...) as things stand."""
        n = self.now.n
        if rows and n:
            table = np.moveaxis(table, 0, n)
        if self.bounded:
            table = np.expand_dims(table, n + rows)
        if not n:
            return table
        lead = self.lead - 1
        return evaluate(table, self._values_of(cell.depends), lead, table.ndim - n - rows - lead)

    def unseen(self, known: Range, trailing: tuple[int, ...]) -> Array:
        """The same values at all samples to come."""
        shape = (self.tail.count, 2, 1, *trailing) if self.bounded else (self.tail.count, 1, *trailing)
        values = np.empty(shape)
        if self.bounded:
            values[:, 0], values[:, 1] = known
        return values

    def ahead(self, x: Array, by: int) -> Array:
        """The values with ``by`` samples after the last one, if the trace is endless."""
        return self.algebra.ahead(x, by) if len(x) else x

    def within(self, first: int, lo: int, hi: float) -> slice:
        """Which of the values from sample ``first`` on are at the samples ``lo .. hi``."""
        begin, end = self._row(lo), self._row(hi)
        return slice(
            max(0, int(min(begin, self.last + 1)) - first), max(0, int(min(end, self.last)) + 1 - first)
        )

    def common_row(self, sample: int) -> int | None:
        """The row that stands for a sample, if it is that of an earlier one."""
        ahead = sample - self.now.t - 1
        return (
            self.now.t + 1 + self.tail.common if self.tail.common < ahead <= self.tail.common_last else None
        )

    def like(self, cell: Cell, value: float) -> Array:
        """The same value for every particle and vehicle of a cell."""
        if self.count(cell):
            return np.full_like(self.open(cell)[0], value)
        settled = self.settled(cell, 1)
        assert settled is not None
        return np.full_like(settled[0], value)

    def _row(self, sample: float) -> float:
        """Where a sample is, counting rows as samples."""
        tail, first = self.tail, self.now.t + 1
        ahead = sample - first
        if ahead <= tail.common:
            return sample
        if ahead <= tail.common_last:
            return first + tail.common
        return math.inf if math.isinf(sample) else sample - (tail.common_last - tail.common)

    def _values_of(self, depends: frozenset[int]) -> list[Array | None]:
        return [self._frontier(cell) if i in depends else None for i, cell in enumerate(self._obligations)]

    def _frontier(self, cell: Obligation) -> Array:
        """An unbounded future operator's value at its first sample that is not settled."""
        if self.count(cell):
            return np.asarray(self.open(cell)[0])
        return np.full((2, 1) if self.bounded else 1, neutral(cell.join))
