"""Sub-formulas of a monitor, which follow a trace one sample at a time.

A cell with delay d (samples it looks ahead, unbounded operators counting 0) knows its value at sample t - d
for good once sample t is seen, as a table over ``corners``. ``value`` gives it, and without corners also the
values at later samples, as things stand; ``open`` gives those in all other cases, all of them at once. This
module has the cells without time; ``temporal`` has the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.robustness import connect, quantify
from avrare.logic.terms import align, reader

if TYPE_CHECKING:
    from avrare.logic.region import Region

Array = NDArray[Any]


class Moment:
    """What the cells know at sample t.

    Args:
        t: The newest sample.
        rows: N.
        sample: name -> (N, ...).
        algebra: What values are.
        tables: As they were before this sample.
        n: Number of corner axes.

    Attributes:
        tables: Per cell, its newest settled values (corners, N, ...), oldest first; before this sample until
            the cell has settled.
        values: Per unbounded future operator, its newly settled value.
    """

    __slots__ = ("_open", "algebra", "n", "rows", "sample", "t", "tables", "values")

    def __init__(
        self,
        t: int,
        rows: int,
        sample: Mapping[str, Array],
        algebra: Robustness,
        tables: Iterable[tuple[Array, ...]],
        n: int,
    ) -> None:
        self.t, self.rows, self.sample, self.algebra, self.n = t, rows, sample, algebra, n
        self.tables = list(tables)
        self.values: list[Array | None] = [None] * n
        self._open: dict[tuple[int, int], Array] = {}

    def at(self, cell: Cell, i: int) -> Array:
        """The cell's value at sample ``i``; where that is not settled, as things stand.

        The latter only without corners, and a few samples ahead: operators ask each other.
        """
        ahead = i - self.t + cell.delay
        if ahead <= 0:
            return self.tables[cell.index][ahead - 1]
        key = cell.index, i
        if key not in self._open:
            self._open[key] = cell.value(self, i)
        return self._open[key]

    def last(self, cell: Cell, i: int) -> Array | None:
        """The value before sample ``i`` of a cell that asks for its own; None before the first."""
        if i > self.t - cell.delay:
            return self.at(cell, i - 1) if i else None
        before = self.tables[cell.index]
        return before[-1] if before else None


class Cell:
    """A sub-formula.

    Args:
        children: Its operands.
        ahead: Samples that it looks ahead of its operands.
        behind: Samples that it looks back at its operands.

    Attributes:
        index: Its place among the cells; operands come first.
        delay: Samples until a value is settled.
        keep: Settled values that others will ask for, beside the newest.
        depends: Which corner axes its values depend on.
        obligation: For an unbounded future operator, its corner axis.
    """

    obligation: int | None = None

    def __init__(self, children: Sequence[Cell] = (), ahead: int = 0, behind: int = 0) -> None:
        self.index = 0
        self.keep = 0
        self.children = tuple(children)
        self.delay: int = max((child.delay for child in children), default=0) + ahead
        self.depends: frozenset[int] = frozenset().union(*(child.depends for child in children))
        for child in children:
            child.keep = max(child.keep, self.delay - child.delay + behind)

    def value(self, now: Moment, i: int) -> Array:
        """The value (corners, N, ...) at sample ``i``, from those of its operands."""
        raise NotImplementedError

    def settle(self, now: Moment) -> Array:
        """The value that sample t settles."""
        return self.value(now, now.t - self.delay)

    def open(self, region: Region) -> Array:
        """The values (P, ...) at the samples of ``region`` that are not settled."""
        raise NotImplementedError


class Atom(Cell):
    """A comparison."""

    def __init__(self, node: f.Comparison) -> None:
        super().__init__()
        self.node = node
        self._left, self._right = reader(node.left, 1), reader(node.right, 1)

    def value(self, now: Moment, i: int) -> Array:
        """The newest sample's value."""
        left, right = self._left(now.sample), self._right(now.sample)
        if type(right) is not float:
            left, right = align(left, right)
        value = now.algebra.atom(self.node, left, right)
        if not isinstance(value, np.ndarray):
            value = np.full(now.rows, value)
        return value.reshape((1,) * now.n + value.shape) if now.n else value  # type: ignore[no-any-return]

    def open(self, region: Region) -> Array:
        """What is known of samples that are not seen."""
        newest = region.now.tables[self.index][-1]
        return region.unseen(region.exact.unseen(self.node), newest.shape[region.now.n + 1 :])


class Truth(Cell):
    """true or false."""

    def __init__(self, value: float) -> None:
        super().__init__()
        self._margin = value

    def value(self, now: Moment, i: int) -> Array:
        """Plus or minus infinity."""
        return np.full((1,) * now.n + (now.rows,), self._margin)

    def open(self, region: Region) -> Array:
        """Plus or minus infinity."""
        return region.unseen((self._margin, self._margin), ())


class Joined(Cell):
    """and, or, iff, xor."""

    def __init__(self, op: str, left: Cell, right: Cell) -> None:
        super().__init__([left, right])
        self.op = op

    def value(self, now: Moment, i: int) -> Array:
        """Both operands at the same sample."""
        left, right = self.children
        return connect(self.op, now.at(left, i), now.at(right, i), now.algebra)

    def open(self, region: Region) -> Array:
        """Both operands at the same samples."""
        left, right = (region.rows(child, region.start(self)) for child in self.children)
        return connect(self.op, left, right, region.algebra)


class Negated(Cell):
    """not."""

    def __init__(self, child: Cell) -> None:
        super().__init__([child])

    def value(self, now: Moment, i: int) -> Array:
        """The operand's opposite."""
        return now.algebra.negate(now.at(self.children[0], i))

    def open(self, region: Region) -> Array:
        """The operand's opposite."""
        return region.algebra.negate(region.open(self.children[0]))


class Quantified(Cell):
    """forall, exists, at_least."""

    def __init__(self, node: f.Quantifier, child: Cell) -> None:
        super().__init__([child])
        self.node = node

    def value(self, now: Moment, i: int) -> Array:
        """The order statistic of the operand."""
        return quantify(self.node, now.at(self.children[0], i), now.n + 1)

    def open(self, region: Region) -> Array:
        """The order statistic of the operand."""
        return quantify(self.node, region.open(self.children[0]), region.lead)
