"""Monitor nodes: sub-formulas followed one sample at a time, and the tables of their values.

With delay d (samples that it looks ahead, obligations counting 0) a node's value at sample t - d is settled
once sample t is seen: as a table over corners, no later sample changes it. A bounded window is settled by a
chain of pairs: two windows of 2^k samples, overlapping or not, make the wider one. A bounded until or since
folds the newest values of its operands. An unbounded past operator needs only its own last value; an
unbounded future one is an obligation with a corner axis of its own, or its values stay open.

The value of a formula as a function of its obligations' values at the next sample, x_1..x_n, is composed of
minimum and maximum. It is monotone in every x_i, and

    f(x) = max(f(x with x_i = -inf), min(f(x with x_i = inf), x_i)),

so its values at the 2^n corners determine it. A table has n leading axes, the i-th of length 2 (first minus
infinity, then infinity) if the value depends on x_i, else of length 1: tables broadcast against each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from avrare.logic.semantics.trace_evaluator import align, broadcast, compile_term, get_join, operate
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, get_dual, get_neutral
from avrare.logic.syntax import nodes

NEVER = 10**18
"""Delay of a node whose values all stay open."""


@dataclass(slots=True)
class SampleContext:
    """Values of the nodes at the newest sample t.

    Attributes:
        t: Newest sample.
        rows: N.
        sample: name -> (N, ...).
        algebra: Algebra of the values.
        closed: True if until and since need their left operand at the witness.
        tables: Newest settled values (corners, N, ...) of each node, oldest first; those before this sample
            until the node has settled.
        values: Newly settled value of each obligation, by corner axis; None until then.
    """

    t: int
    rows: int
    sample: Mapping[str, Array]
    algebra: RobustnessAlgebra
    closed: bool
    tables: list[tuple[Array, ...]]
    values: list[Array | None]
    _open: dict[tuple[int, int], Array] = field(default_factory=dict)

    def at(self, node: MonitorNode, i: int) -> Array:
        """Return the node's value at sample ``i``; without corners it may be open, and is nominal then."""
        ahead = i - self.t + node.delay
        if ahead <= 0:
            return self.tables[node.index][ahead - 1]
        key = node.index, i
        if key not in self._open:
            self._open[key] = node.value(self, i)
        return self._open[key]


class MonitorNode:
    """Sub-formula, in this class an operator without time: not, and, or, iff, xor or a quantifier.

    Attributes:
        formula: Sub-formula in normal form.
        operands: Nodes of its direct sub-formulas.
        delay: Samples until a value is settled.
        behind: Samples before its own that a value needs.
        keep: Settled values that other nodes need, in addition to the newest.
        index: Position among the nodes of the monitor; operands come first.
        axis: Corner axis of an obligation, else None.
    """

    axis: int | None = None

    def __init__(
        self, formula: nodes.Node, operands: Sequence[MonitorNode], ahead: int = 0, behind: int = 0
    ) -> None:
        self.formula, self.operands, self.behind = formula, tuple(operands), behind
        self.delay: int = max((node.delay for node in operands), default=0) + ahead
        self.keep = self.index = 0
        for node in operands:
            node.keep = max(node.keep, self.delay - node.delay + behind)

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value (corners, N, ...) at sample ``i``, from those of the operands."""
        operands = [now.at(node, i) for node in self.operands]
        return operate(self.formula, operands, now.algebra, now.closed, len(now.values) + 1)

    def settle(self, now: SampleContext) -> Array:
        """Return the value that the newest sample settles."""
        return self.value(now, now.t - self.delay)


class ComparisonNode(MonitorNode):
    """Comparison of two terms."""

    def __init__(self, formula: nodes.Comparison) -> None:
        super().__init__(formula, ())
        self._comparison = formula
        self._left, self._right = compile_term(formula.left, 1), compile_term(formula.right, 1)

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value at the newest sample, which is ``i``."""
        left, right = self._left(now.sample), self._right(now.sample)
        if type(right) is not float:
            left, right = align(left, right)
        value = now.algebra.compare(self._comparison, left, right)
        margin: Array = value if isinstance(value, np.ndarray) else np.full(now.rows, value)
        return margin.reshape((1,) * len(now.values) + margin.shape) if now.values else margin


class PairNode(MonitorNode):
    """Join of the values of ``half`` at two samples, ``near`` and ``far`` ones ahead (behind if negative).

    The last pair of a chain is the bounded window ``formula`` over the node ``base``.

    Attributes:
        join: ``np.minimum`` or ``np.maximum``.
        clipped: Newest samples at which a window that begins at its own sample is clipped.
    """

    def __init__(
        self, formula: nodes.Window, half: MonitorNode, near: int, far: int, base: MonitorNode | None = None
    ) -> None:
        super().__init__(formula, [half], max(far, 0), max(-far, 0))
        newest, reach = max(far, 0) + 1, int(formula.hi)
        self._half, self._near, self._far, self.join = half, near, far, get_join(formula.op)
        self._rows, self.clipped = (near - newest, far - newest), 0
        if base is not None:
            self.operands, self.behind = (base,), reach if far < 0 else 0
            base.keep = max(base.keep, reach)
            self.clipped = reach if far > 0 and not near else 0

    def settle(self, now: SampleContext) -> Array:
        """Return the value that the newest sample settles."""
        # Both values are in the table, as soon as that goes back far enough.
        settled, (near, far) = now.tables[self._half.index], self._rows
        if len(settled) < -min(near, far):
            return self.value(now, now.t - self.delay)
        value: Array = settled[near]
        return value if near == far else self.join(value, settled[far])

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the join of the values inside the trace; neutral if there are none."""
        if i + self.clipped > now.t:  # the next sample's window is extended
            value = now.at(self.operands[0], i)
            return value if i == now.t else self.join(value, now.at(self, i + 1))
        inside = [now.at(self._half, k) for k in {i + self._near, i + self._far} if 0 <= k <= now.t]
        if not inside:
            return np.full_like(now.at(self._half, i), get_neutral(self.join))
        return inside[0] if len(inside) == 1 else np.asarray(self.join(*inside))


class UntilNode(MonitorNode):
    """Bounded until, since, release or trigger; the base of the other temporal operators."""

    def __init__(
        self, formula: nodes.Window | nodes.Until, operands: Sequence[MonitorNode], reach: int = 0
    ) -> None:
        past = formula.op in nodes.PAST
        super().__init__(formula, operands, 0 if past else reach, reach if past else 0)
        self.join = get_join(formula.op)
        self._meet, self._lo, self._reach, self._past = get_dual(self.join), formula.lo, reach, past

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value, from the farthest witness to the nearest."""
        left, right = self.operands
        last = min(self._reach, i if self._past else now.t - i)
        if not self._past and not self._lo and last < self._reach:  # clipped: the next sample's value is used
            return self._expand(now, i, now.at(self, i + 1) if last else get_neutral(self.join))
        value = np.full_like(broadcast(now.at(left, i), now.at(right, i))[0], get_neutral(self.join))
        for k in range(last, -1 if last >= self._lo else last, -1):
            sample = i - k if self._past else i + k
            if k >= self._lo:
                value = self._expand(now, sample, value)
            else:
                value = self._meet(*align(now.at(left, sample), value))
        return value

    def _expand(self, now: SampleContext, i: int, later: Array | float) -> Array:
        # Expansion law: a future operator from its value at the next sample, a past one from the previous.
        operands, value = [now.at(node, i) for node in self.operands], later
        if len(operands) == 1:
            return np.asarray(self.join(*align(later, operands[0])))
        left, right = broadcast(*operands)
        value = align(left, later)[1]
        if now.closed:
            return np.asarray(self._meet(left, self.join(right, value)))
        return np.asarray(self.join(right, self._meet(left, value)))


class PastNode(UntilNode):
    """once, historically, since and trigger over the entire past."""

    def __init__(self, formula: nodes.Window | nodes.Until, operands: Sequence[MonitorNode]) -> None:
        super().__init__(formula, operands)
        self.keep = 1

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value, from that of the sample before."""
        settled = now.tables[self.index]
        if i > now.t - self.delay and i:
            return self._expand(now, i, now.at(self, i - 1))
        return self._expand(now, i, settled[-1] if settled else get_neutral(self.join))


class ObligationNode(UntilNode):
    """Unbounded future operator, whose value at the next sample is the corner of ``axis``.

    Without an axis its values stay open.
    """

    def __init__(
        self, formula: nodes.Window | nodes.Until, operands: Sequence[MonitorNode], axis: int | None
    ) -> None:
        super().__init__(formula, operands, NEVER if axis is None else 0)
        self.axis = axis

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the settled value as a table over the corners."""
        assert self.axis is not None
        shape = [1] * (len(now.values) + 1)
        shape[self.axis] = 2
        return self._expand(now, i, np.array([-math.inf, math.inf]).reshape(shape))


def collapse(table: Array, values: Sequence[Array | None], lead: int) -> Array:
    """Evaluate a table (corners, ...) at ``values``, one for each corner axis.

    Values and the table without its corners have ``lead`` axes before those of vehicles. None stands for an
    axis that the table does not depend on.
    """
    trailing = table.ndim - len(values) - lead
    for value in values:
        low = table[0]
        if len(table) == 1:
            table = low
            continue
        assert value is not None
        value = value.reshape(value.shape + (1,) * (lead + trailing - value.ndim))
        table = np.maximum(low, np.minimum(table[1], value))
    return table


def compose(table: Array, values: Sequence[Array | None]) -> Array:
    """Convert a table over the x of this sample to one over the x of the next, by the old x as tables."""
    n = len(values)
    if table.shape[:n] == (1,) * n:
        return table
    return collapse(table.reshape(*table.shape[:n], *(1,) * n, *table.shape[n:]), values, n + 1)
