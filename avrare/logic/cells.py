"""Sub-formulas of a monitor, which follow a trace one sample at a time.

A cell with delay d (samples it looks ahead, unbounded operators counting 0) knows its value at sample t - d
for good once sample t is seen, as a table over ``corners``: that is ``settle``. ``open`` gives its values at
the samples after t - d, as things stand. This module has the cells without time; ``temporal`` has the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


@dataclass
class Moment:
    """What the cells know at sample t.

    Attributes:
        t: The newest sample.
        rows: N.
        sample: name -> (N, ...).
        algebra: What values are.
        n: Number of corner axes.
        tables: Per cell, its newest settled values (K, corners, N, ...), oldest first; None before the first.
        before: The values (K, corners, N, ...) of the cell in hand before this sample; None before the first.
        values: Per unbounded future operator, its newly settled value.
    """

    t: int
    rows: int
    sample: Mapping[str, Array]
    algebra: Robustness
    n: int
    tables: list[Array | None]
    before: Array | None
    values: list[Array | None]

    def between(self, cell: Cell, back: int, until: int) -> Array:
        """The cell's values at the samples ``t - back .. t - until``, clipped at sample 0."""
        table = self.tables[cell.index]
        assert table is not None
        newest = len(table) - 1 + cell.delay
        return table[max(0, newest - back) : max(0, newest - until + 1)]

    def at(self, cell: Cell, back: int) -> Array:
        """The cell's value at sample ``t - back``."""
        table = self.tables[cell.index]
        assert table is not None
        return table[cell.delay - back - 1]  # type: ignore[no-any-return]


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

    def settle(self, now: Moment) -> Array:
        """The value (corners, N, ...) at sample ``t - delay``."""
        raise NotImplementedError

    def open(self, region: Region) -> Array:
        """The values (P, ...) at the samples of ``region`` that are not settled."""
        raise NotImplementedError


class Atom(Cell):
    """A comparison."""

    def __init__(self, node: f.Comparison) -> None:
        super().__init__()
        self.node = node
        self._left, self._right = reader(node.left, 1), reader(node.right, 1)

    def settle(self, now: Moment) -> Array:
        """The newest sample's value."""
        value = now.algebra.atom(self.node, *align(self._left(now.sample), self._right(now.sample)))
        if not isinstance(value, np.ndarray):
            value = np.full(now.rows, value)
        return np.asarray(value.reshape((1,) * now.n + value.shape) if now.n else value)

    def open(self, region: Region) -> Array:
        """What is known of samples that are not seen."""
        table = region.now.tables[self.index]
        assert table is not None
        return region.unseen(region.exact.unseen(self.node), table.shape[region.now.n + 2 :])


class Truth(Cell):
    """true or false."""

    def __init__(self, value: float) -> None:
        super().__init__()
        self.value = value

    def settle(self, now: Moment) -> Array:
        """Plus or minus infinity."""
        return np.full((1,) * now.n + (now.rows,), self.value)

    def open(self, region: Region) -> Array:
        """Plus or minus infinity."""
        return region.unseen((self.value, self.value), ())


class Joined(Cell):
    """and, or, iff, xor."""

    def __init__(self, op: str, left: Cell, right: Cell) -> None:
        super().__init__([left, right])
        self.op = op

    def settle(self, now: Moment) -> Array:
        """Both operands at the same sample."""
        left, right = self.children
        return connect(self.op, now.at(left, self.delay), now.at(right, self.delay), now.algebra)

    def open(self, region: Region) -> Array:
        """Both operands at the same samples."""
        left, right = (region.rows(child, region.start(self)) for child in self.children)
        return connect(self.op, left, right, region.algebra)


class Negated(Cell):
    """not."""

    def __init__(self, child: Cell) -> None:
        super().__init__([child])

    def settle(self, now: Moment) -> Array:
        """The operand's opposite."""
        return now.algebra.negate(now.at(self.children[0], self.delay))

    def open(self, region: Region) -> Array:
        """The operand's opposite."""
        return region.algebra.negate(region.open(self.children[0]))


class Quantified(Cell):
    """forall, exists, at_least."""

    def __init__(self, node: f.Quantifier, child: Cell) -> None:
        super().__init__([child])
        self.node = node

    def settle(self, now: Moment) -> Array:
        """The order statistic of the operand."""
        return quantify(self.node, now.at(self.children[0], self.delay), now.n + 1)

    def open(self, region: Region) -> Array:
        """The order statistic of the operand."""
        return quantify(self.node, region.open(self.children[0]), region.lead)
