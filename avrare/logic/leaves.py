"""The parts of a formula's value at sample 0 that change as samples arrive.

A leaf folds the values of its cells that are settled into what it carries, and joins it with the values that
are open; connectives and quantifiers above the leaves are then applied to one value each. What is carried are
tables (corners, N, ...).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.logic.algebra import Bounds
from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import compose
from avrare.logic.formula import Node, settling, signals
from avrare.logic.region import Region
from avrare.logic.robustness import Evaluator
from avrare.logic.temporal import broadcast, join_rows
from avrare.logic.terms import align
from avrare.logic.windows import accumulate, neutral, other

Array = NDArray[Any]
Carried = tuple[Array, ...] | None


class Leaf(Protocol):
    """A sub-formula at sample 0."""

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """What to carry on after one more sample; None before anything is settled."""

    def value(self, region: Region, carried: Carried) -> Array:
        """The value, (N, ...) or as bounds (2, N, ...)."""


class Point:
    """Any formula that a cell follows."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """The value at sample 0, once it is settled."""
        if carried is not None:
            return _renew(carried, now, self.cell)
        return (now.at(self.cell, now.t),) if now.t == self.cell.delay else None

    def value(self, region: Region, carried: Carried) -> Array:
        """The settled value or the open one."""
        if carried is None:
            return np.asarray(region.open(self.cell)[0])
        return region.collapse(carried[0], self.cell)


class Fold:
    """always or eventually: a running extremum of the settled values, joined with the open ones."""

    def __init__(self, join: np.ufunc, lo: int, hi: float, cell: Cell) -> None:
        self.join, self.lo, self.hi, self.cell = join, lo, hi, cell

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """Fold the newly settled value."""
        sample = now.t - self.cell.delay
        if carried is not None:
            carried = _renew(carried, now, self.cell)
        if not max(self.lo, 0) <= sample <= self.hi:
            return carried
        value = now.at(self.cell, self.cell.delay)
        return (value,) if carried is None else (self.join(carried[0], value),)

    def value(self, region: Region, carried: Carried) -> Array:
        """The fold of all samples of the window."""
        folded = None if carried is None else region.collapse(carried[0], self.cell)
        x: Any = ()
        if region.count(self.cell):
            x, start = region.open(self.cell), region.start(self.cell)
            if start < self.lo or self.hi < region.end:
                x = x[region.within(start, self.lo, self.hi)]
        if not len(x):
            return region.like(self.cell, neutral(self.join)) if folded is None else folded
        rest = np.asarray(x[0] if len(x) == 1 else self.join.reduce(x, axis=0))
        return rest if folded is None else np.asarray(self.join(*align(folded, rest)))


class Race:
    """until: how well the left has held, and the best witness so far; release with min and max exchanged."""

    def __init__(self, join: np.ufunc, lo: int, hi: float, cells: tuple[Cell, Cell], closed: bool) -> None:
        self.join, self.lo, self.hi, self.closed = join, lo, hi, closed
        self.left, self.right = cells
        self.pair = Cell(cells)

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """Look at one more possible witness."""
        delay = self.pair.delay
        if carried is not None:
            carried = _renew(carried, now, self.pair)
        if not 0 <= now.t - delay <= self.hi:
            return carried
        left, right = broadcast(now.at(self.left, delay), now.at(self.right, delay))
        if carried is None:
            ends = neutral(other(self.join)), neutral(self.join)
            carried = np.full_like(left, ends[0]), np.full_like(left, ends[1])
        meet, (before, best) = other(self.join), carried
        held = meet(before, left)
        if now.t - delay >= self.lo:
            best = self.join(best, meet(right, held if self.closed else before))
        return held, best

    def value(self, region: Region, carried: Carried) -> Array:
        """The best of the settled witnesses and the open ones."""
        before, best = (None, None) if carried is None else (region.collapse(x, self.pair) for x in carried)
        if best is not None and not region.count(self.pair):
            return best
        first, meet = region.start(self.pair), other(self.join)
        left, right = broadcast(region.rows(self.left, first), region.rows(self.right, first))
        if before is None:
            before = np.full_like(left[0], neutral(meet))
        held = accumulate(meet, join_rows(before[None], left))
        allowed = region.within(first, self.lo, self.hi)
        witnesses = meet(right[allowed], self._until_witness(region, held)[allowed])
        found = np.asarray(self.join.reduce(witnesses, axis=0, initial=neutral(self.join)))
        return found if best is None else np.asarray(self.join(best, found))

    def _until_witness(self, region: Region, held: Array) -> Array:
        """How well the left holds before each row's first sample in the window, or until it where closed."""
        if self.closed:
            return held[1:]
        common = region.common_row(self.lo)
        if common is not None:  # the samples before it in its row need the left operand too
            row = common - region.start(self.pair)
            held[row] = held[row + 1]
        return held[:-1]


class Replay:
    """Any other formula: evaluated anew on all samples."""

    def __init__(self, node: Node, closed: bool) -> None:
        self.node, self.closed = node, closed
        self.names = signals(node)

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """Keep the sample."""
        newest = [now.sample[name][:, None] for name in self.names]
        newest = [x.reshape((1,) * now.n + x.shape) for x in newest]
        if carried is None:
            return tuple(x.copy() for x in newest)
        return tuple(np.concatenate(pair, axis=now.n + 1) for pair in zip(carried, newest, strict=True))

    def value(self, region: Region, carried: Carried) -> Array:
        """Evaluate the whole prefix."""
        now, tail = region.now, region.tail
        arrays = [np.moveaxis(x.reshape(x.shape[now.n :]), 1, 0) for x in carried or ()]
        algebra = region.exact
        if region.bounded:
            grid = tail.length or now.t + 2 + settling(self.node)
            algebra = Bounds(region.exact, grid, endless=tail.length is None)
        samples = dict(zip(self.names, arrays, strict=True))
        evaluate = Evaluator(samples, now.t + 1, now.rows, algebra, self.closed)
        return np.asarray(evaluate(self.node)[0])


def _renew(carried: tuple[Array, ...], now: Moment, cell: Cell) -> tuple[Array, ...]:
    """What is carried, as tables over the next sample's corners."""
    return tuple(compose(x, now.values, 0) for x in carried) if cell.depends else carried
