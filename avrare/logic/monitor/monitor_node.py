"""Base of monitor nodes, the tables of their values, and the samples at which they are evaluated.

A monitor node is a sub-formula followed one sample at a time. With delay d (samples that it looks ahead,
unbounded operators counting 0) its value at sample t - d is settled once sample t is seen: as a table over
corners, no later sample changes it. Values at later samples are open: they are given for the trace as it is
(nominal), or as bounds over all samples to come.

The value of a formula as a function of its unbounded future operators' values at the next sample, x_1..x_n,
is composed of minimum and maximum. It is monotone in every x_i, and

    f(x) = max(f(x with x_i = -inf), min(f(x with x_i = inf), x_i)),

so its values at the 2^n corners determine it. A table has n leading axes, the i-th of length 2 (first minus
infinity, then infinity) if the value depends on x_i, else of length 1: tables broadcast against each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from avrare.logic.semantics.trace_evaluator import align
from avrare.logic.semantics.value_algebra import IntervalAlgebra, Range, RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, get_neutral

MAX_CORNERS = 4
"""Unbounded future operators n in a table, at most: a step costs up to 4^n operations per particle."""


class MonitorNode:
    """Sub-formula of a monitor, which looks ``ahead`` and ``behind`` at the samples of its operands.

    Attributes:
        index: Position among the nodes of the monitor; operands come first.
        keep: Settled values that other nodes need, in addition to the newest.
        obligation: Corner axis of an unbounded future operator, else None.
        join: ``np.minimum`` or ``np.maximum``, by which a temporal operator joins its samples.
        delay: Samples until a value is settled.
        depends: Corner axes that its values depend on.
    """

    index = 0
    keep = 0
    obligation: int | None = None
    join: np.ufunc

    def __init__(self, children: Sequence[MonitorNode] = (), ahead: int = 0, behind: int = 0) -> None:
        self.children = tuple(children)
        self.delay: int = max((child.delay for child in children), default=0) + ahead
        self.depends: frozenset[int] = frozenset().union(*(child.depends for child in children))
        for child in children:
            child.keep = max(child.keep, self.delay - child.delay + behind)

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value (corners, N, ...) at sample ``i``, from those of the operands."""
        raise NotImplementedError

    def settle(self, now: SampleContext) -> Array:
        """Return the value that the newest sample settles."""
        return self.value(now, now.t - self.delay)

    def open(self, samples: OpenSamples) -> Array:
        """Return the values (P, ...) at all open samples."""
        raise NotImplementedError


@dataclass(slots=True)
class SampleContext:
    """Values of the nodes at the newest sample t.

    Attributes:
        t: Newest sample.
        rows: N.
        sample: name -> (N, ...).
        algebra: Algebra of the values.
        tables: Newest settled values (corners, N, ...) of each node, oldest first; those before this sample
            until the node has settled.
        n: Number of corner axes.
        values: Newly settled value of each unbounded future operator, None until then.
    """

    t: int
    rows: int
    sample: Mapping[str, Array]
    algebra: RobustnessAlgebra
    tables: list[tuple[Array, ...]]
    n: int
    values: list[Array | None]
    _open: dict[tuple[int, int], Array] = field(default_factory=dict)

    def at(self, node: MonitorNode, i: int) -> Array:
        """Return the value of the node at sample ``i``, the nominal one while it is open.

        Open values are available only without corners, and a few samples ahead: nodes ask each other.
        """
        ahead = i - self.t + node.delay
        if ahead <= 0:
            return self.tables[node.index][ahead - 1]
        key = node.index, i
        if key not in self._open:
            self._open[key] = node.value(self, i)
        return self._open[key]

    def before(self, node: MonitorNode, i: int) -> Array | None:
        """Return the value before sample ``i`` to a node that needs its own; None at sample 0."""
        if i > self.t - node.delay:
            return self.at(node, i - 1) if i else None
        settled = self.tables[node.index]
        return settled[-1] if settled else None


@dataclass(frozen=True)
class UnseenSamples:
    """Samples not seen yet, as rows of an array.

    Attributes:
        count: Number of rows.
        common: Row that represents many equal samples, counted from the first one not seen.
        common_last: Last sample that it represents, counted alike; ``math.inf`` in an endless trace.
        length: Samples of the complete trace; None: endless.
    """

    count: int = 0
    common: int = 0
    common_last: float = 0
    length: int | None = None


def lay_out_unseen_samples(seen: int, settling: int, horizon: int, length: int | None) -> UnseenSamples:
    """Lay out the unseen samples of a trace in few rows.

    Values are constant from ``settling`` samples after the last one seen to ``horizon`` samples before the
    end: one row represents all of them.
    """
    if length is None:
        return UnseenSamples(settling + 1, settling, math.inf)
    left, needed = length - seen, settling + 1 + horizon
    if left <= needed:
        return UnseenSamples(left, left, left, length)
    return UnseenSamples(needed, settling, left - 1 - horizon, length)


class OpenSamples:
    """Values of nodes at the samples after their settled ones: (P, N, ...), or (P, 2, N, ...) as bounds.

    Args:
        now: Newest sample, all nodes settled.
        obligations: Unbounded future operators, by corner axis.
        unseen: Samples not seen yet; None gives nominal values, of the trace as it is.

    Attributes:
        last: Last row, counting rows as samples.
    """

    def __init__(
        self, now: SampleContext, obligations: Sequence[MonitorNode], unseen: UnseenSamples | None = None
    ) -> None:
        self.now = now
        self.bounded = unseen is not None
        self.unseen = unseen or UnseenSamples()
        self.algebra = now.algebra
        if self.bounded:
            self.algebra = IntervalAlgebra(now.algebra, 0, endless=math.isinf(self.unseen.common_last))
        self.lead = 3 if self.bounded else 2
        self.last = now.t + self.unseen.count
        self._obligations = obligations
        self._values: dict[int, Array] = {}

    def start(self, node: MonitorNode) -> int:
        """Return the first open sample of the node."""
        return max(0, self.now.t - node.delay + 1)

    def count(self, node: MonitorNode) -> int:
        """Return the number of open samples of the node."""
        return self.last - self.start(node) + 1

    def open(self, node: MonitorNode) -> Array:
        """Return the node's open values."""
        if node.index not in self._values:
            self._values[node.index] = node.open(self)
        return self._values[node.index]

    def rows(self, node: MonitorNode, first: int) -> Array:
        """Return the node's values from sample ``first`` on."""
        wanted = self.start(node) - first
        if wanted <= 0:
            return self.open(node)[-wanted:]
        settled = self.read_settled(node, wanted)
        assert settled is not None
        return join_rows(settled, self.open(node)) if self.count(node) else settled

    def read_settled(self, node: MonitorNode, count: int) -> Array | None:
        """Return the node's newest settled values, ``count`` of them; None before the first."""
        newest = self.now.tables[node.index][-count:]
        if not newest:
            return None
        return self.collapse(stack(newest), node, 1)

    def collapse(self, table: Array, node: MonitorNode, rows: int = 0) -> Array:
        """Evaluate tables (rows..., corners, N, ...) at the obligations' open values."""
        n = self.now.n
        if rows and n:
            table = np.moveaxis(table, 0, n)
        if self.bounded:
            table = np.expand_dims(table, n + rows)
        if not n:
            return table
        lead = self.lead - 1
        values = [self._first_open(x) if i in node.depends else None for i, x in enumerate(self._obligations)]
        return _evaluate(table, values, lead, table.ndim - n - rows - lead)

    def fill(self, limits: Range, trailing: tuple[int, ...]) -> Array:
        """Return the same values at all unseen samples."""
        count = self.unseen.count
        values = np.empty((count, 2, 1, *trailing) if self.bounded else (count, 1, *trailing))
        if self.bounded:
            values[:, 0], values[:, 1] = limits
        return values

    def ahead(self, x: Array, by: int) -> Array:
        """Return the values extended by ``by`` samples, if the trace is endless."""
        return self.algebra.ahead(x, by) if len(x) else x

    def within(self, first: int, lo: int, hi: float) -> slice:
        """Return the slice of the values from sample ``first`` on that is at the samples ``lo .. hi``."""
        begin, end = min(self._row(lo), self.last + 1), min(self._row(hi), self.last) + 1
        return slice(max(0, int(begin) - first), max(0, int(end) - first))

    def common_row(self, sample: int) -> int | None:
        """Return the row of a sample, if an earlier sample has it too."""
        unseen = self.unseen
        shared = unseen.common < sample - self.now.t - 1 <= unseen.common_last
        return self.now.t + 1 + unseen.common if shared else None

    def _row(self, sample: float) -> float:
        unseen, first = self.unseen, self.now.t + 1
        ahead = sample - first
        if ahead <= unseen.common:
            return sample
        if ahead <= unseen.common_last:
            return first + unseen.common
        return math.inf if math.isinf(sample) else sample - (unseen.common_last - unseen.common)

    def _first_open(self, node: MonitorNode) -> Array:
        if self.count(node):
            return np.asarray(self.open(node)[0])
        return np.full((2, 1) if self.bounded else 1, get_neutral(node.join))


def broadcast(left: Array, right: Array) -> tuple[Array, Array]:
    """Return two operands with all their axes."""
    if left.shape == right.shape:
        return left, right
    left, right = np.broadcast_arrays(*align(left, right))
    return left, right


def join_rows(settled: Array, rows: Array) -> Array:
    """Concatenate values that may differ in axes that broadcast."""
    ndim = max(settled.ndim, rows.ndim)
    settled, rows = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (settled, rows))
    shape = np.broadcast_shapes(settled.shape[1:], rows.shape[1:])
    return np.concatenate([np.broadcast_to(x, (len(x), *shape)) for x in (settled, rows)])


def make_corner(i: int, n: int) -> Array:
    """Return the table of x_i itself: n corner axes and one for the particles."""
    shape = [1] * (n + 1)
    shape[i] = 2
    return np.array([-math.inf, math.inf]).reshape(shape)


def _evaluate(table: Array, values: Sequence[Array | None], lead: int, trailing: int) -> Array:
    """Evaluate a table (corners, ...), the ``trailing`` last axes of which belong to vehicles, at ``values``.

    A value, None for an axis that the table does not depend on, has ``lead`` axes before those of vehicles;
    it broadcasts from the right against the table without its corner axes.
    """
    for value in values:
        low = table[0]
        if len(table) == 1:
            table = low
            continue
        assert value is not None
        missing = lead + trailing - value.ndim
        value = value.reshape(value.shape + (1,) * missing) if missing else value
        table = np.maximum(low, np.minimum(table[1], value))
    return table


def compose(tables: Array, values: Sequence[Array | None], rows: int) -> Array:
    """Convert tables over the x of this sample to tables over the x of the next one.

    Args:
        tables: (rows..., corners, N, ...).
        values: Old x_i as tables over the new ones, (corners, N, ...) each.
        rows: Number of axes before the corners, 0 or 1.
    """
    n = len(values)
    if rows:
        tables = np.moveaxis(tables, 0, n)
    before = tables.shape[: n + rows]
    trailing = tables.ndim - n - rows - 1
    spread = tables.reshape(*before, *(1,) * n, *tables.shape[n + rows :])
    return _evaluate(spread, values, n + 1, trailing)


def stack(tables: Sequence[Array]) -> Array:
    """Stack tables, which may differ in axes that broadcast."""
    if len({table.shape for table in tables}) > 1:
        return np.stack(np.broadcast_arrays(*tables))
    return np.array(tables)
