"""The parts of a formula's value at sample 0 that change as samples arrive.

A leaf folds the values of its cells sample by sample into what it carries, tables (corners, N, ...): for good
those that are settled, and those that are open, as things stand, to tell its value. With corners or bounds
the open ones are joined all at once. Connectives and quantifiers above the leaves are then applied to one
value each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.algebra import Bounds, Robustness
from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import compose
from avrare.logic.formula import Node, settling, signals
from avrare.logic.region import Region
from avrare.logic.robustness import Evaluator
from avrare.logic.temporal import broadcast, join_rows
from avrare.logic.terms import align
from avrare.logic.windows import accumulate, neutral, other

Array = NDArray[Any]
Carried = tuple[Array, ...]


class Leaf:
    """A sub-formula at sample 0.

    Args:
        cell: Whose settled values are folded; None if the leaf does without cells.

    Attributes:
        delay: Samples until a value is settled.
        shrinking: Whether one or two of the open values tell all.
    """

    shrinking = False

    def __init__(self, cell: Cell | None = None) -> None:
        self.cell = cell
        self.delay = cell.delay if cell else 0
        self._depends = bool(cell and cell.depends)

    def settle(self, now: Moment, carried: Carried) -> Carried:
        """What to carry on after one more sample; empty before anything is settled."""
        if self._depends:
            carried = tuple(compose(x, now.values, 0) for x in carried)
        i = now.t - self.delay
        return self.step(now, carried, i) if i >= 0 else carried

    def unsettled(self, t: int) -> Sequence[int]:
        """The samples up to ``t`` that are not settled and matter."""
        return range(max(0, t - self.delay + 1), t + 1)

    def step(self, now: Moment, carried: Carried, i: int) -> Carried:
        """What is carried with sample ``i`` too."""
        raise NotImplementedError

    def result(self, now: Moment, carried: Carried) -> Array:
        """The value (N, ...) of all samples carried, without corners."""
        return carried[-1]

    def nominal(self, now: Moment, carried: Carried) -> Array:
        """The value (N, ...) as things stand, without corners."""
        for i in self.unsettled(now.t) if self.delay else ():
            carried = self.step(now, carried, i)
        return self.result(now, carried)

    def value(self, region: Region, carried: Carried) -> Array:
        """The value, (N, ...) or as bounds (2, N, ...)."""
        raise NotImplementedError


class Point(Leaf):
    """Any formula that a cell follows."""

    cell: Cell

    def unsettled(self, t: int) -> Sequence[int]:
        """Sample 0, until it is settled."""
        return range(t < self.delay)

    def step(self, now: Moment, carried: Carried, i: int) -> Carried:
        """The value at sample 0."""
        return carried or (now.at(self.cell, i),)

    def value(self, region: Region, carried: Carried) -> Array:
        """The settled value or the open one."""
        if not carried:
            return np.asarray(region.open(self.cell)[0])
        return region.collapse(carried[0], self.cell)


class Fold(Leaf):
    """always or eventually: a running extremum of the settled values, joined with the open ones.

    Args:
        join: ``np.minimum`` or ``np.maximum``.
        lo: First sample of the window.
        hi: Last sample of the window; may be infinite.
        cell: The operand.
        shrinking: The open values are extrema the other way, each over a later part of what the one before is
            over, and the first over a part of what the last settled one is over. So the last one decides; as
            long as nothing is settled, the first one tells whether there is NaN.
    """

    cell: Cell

    def __init__(self, join: np.ufunc, lo: int, hi: float, cell: Cell, shrinking: bool) -> None:
        super().__init__(cell)
        self.join, self.lo, self.hi, self.shrinking = join, lo, hi, shrinking

    def unsettled(self, t: int) -> Sequence[int]:
        """Those of the window."""
        settled = t - self.delay
        samples = range(max(self.lo, settled + 1), int(min(self.hi, t)) + 1)
        if not self.shrinking or len(samples) < 2:
            return samples
        return samples[-1:] if settled >= self.lo else samples[:: len(samples) - 1]

    def step(self, now: Moment, carried: Carried, i: int) -> Carried:
        """Fold one more value."""
        if not self.lo <= i <= self.hi:
            return carried
        value = now.at(self.cell, i)
        return (self.join(carried[0], value),) if carried else (value,)

    def result(self, now: Moment, carried: Carried) -> Array:
        """The extremum; neutral before the window."""
        return carried[0] if carried else np.full_like(now.at(self.cell, now.t), neutral(self.join))

    def nominal(self, now: Moment, carried: Carried) -> Array:
        """The extremum; of shrinking values, the newest is enough."""
        if self.shrinking and carried and now.t <= self.hi:
            return self.join(carried[0], self.cell.value(now, now.t))  # type: ignore[no-any-return]
        return super().nominal(now, carried)

    def value(self, region: Region, carried: Carried) -> Array:
        """The fold of all samples of the window."""
        folded = None if not carried else region.collapse(carried[0], self.cell)
        x: Any = ()
        if region.count(self.cell):
            x, start = region.open(self.cell), region.start(self.cell)
            if start < self.lo or self.hi < region.end:
                x = x[region.within(start, self.lo, self.hi)]
        if not len(x):
            return region.like(self.cell, neutral(self.join)) if folded is None else folded
        rest = np.asarray(x[0] if len(x) == 1 else self.join.reduce(x, axis=0))
        return rest if folded is None else np.asarray(self.join(*align(folded, rest)))


class Race(Leaf):
    """until: how well the left has held, and the best witness so far; release with min and max exchanged."""

    cell: Cell

    def __init__(self, join: np.ufunc, lo: int, hi: float, cells: tuple[Cell, Cell], closed: bool) -> None:
        self.pair = Cell(cells)
        super().__init__(self.pair)
        self.join, self.lo, self.hi, self.closed = join, lo, hi, closed
        self.left, self.right = cells

    def step(self, now: Moment, carried: Carried, i: int) -> Carried:
        """Look at one more possible witness."""
        if i > self.hi:
            return carried
        left, right = broadcast(now.at(self.left, i), now.at(self.right, i))
        join, meet = self.join, other(self.join)
        before, best = carried or (np.full_like(left, neutral(meet)), np.full_like(left, neutral(join)))
        held = meet(before, left)
        if i >= self.lo:
            best = join(best, meet(right, held if self.closed else before))
        return held, best

    def value(self, region: Region, carried: Carried) -> Array:
        """The best of the settled witnesses and the open ones."""
        before, best = (None, None) if not carried else (region.collapse(x, self.pair) for x in carried)
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


class Replay(Leaf):
    """Any other formula: evaluated anew on all samples."""

    def __init__(self, node: Node, closed: bool) -> None:
        super().__init__()
        self.node, self.closed = node, closed
        self.names = signals(node)

    def step(self, now: Moment, carried: Carried, i: int) -> Carried:
        """Keep the sample."""
        newest = [now.sample[name][:, None] for name in self.names]
        newest = [x.reshape((1,) * now.n + x.shape) for x in newest]
        if not carried:
            return tuple(x.copy() for x in newest)
        return tuple(np.concatenate(pair, axis=now.n + 1) for pair in zip(carried, newest, strict=True))

    def result(self, now: Moment, carried: Carried) -> Array:
        """Evaluate the whole prefix."""
        return self._evaluate(now, carried, now.algebra)

    def value(self, region: Region, carried: Carried) -> Array:
        """Evaluate the whole prefix."""
        now, tail, algebra = region.now, region.tail, region.exact
        if region.bounded:
            grid = tail.length or now.t + 2 + settling(self.node)
            algebra = Bounds(region.exact, grid, endless=tail.length is None)
        return self._evaluate(now, carried, algebra)

    def _evaluate(self, now: Moment, carried: Carried, algebra: Robustness) -> Array:
        arrays = [np.moveaxis(x.reshape(x.shape[now.n :]), 1, 0) for x in carried]
        samples = dict(zip(self.names, arrays, strict=True))
        evaluate = Evaluator(samples, now.t + 1, now.rows, algebra, self.closed)
        return np.asarray(evaluate(self.node)[0])
