"""Monitor nodes of comparisons, pointwise operators and temporal operators.

A bounded window is settled by a chain of pairs: two windows of 2^k samples, overlapping or not, make the
wider one. A bounded until or since asks its operands for their newest values. An unbounded past operator
needs only its own last value; an unbounded future one is an obligation with a corner axis of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from avrare.logic.monitor.corner_tables import corner
from avrare.logic.monitor.monitor_node import MonitorNode, OpenSamples, SampleContext, broadcast, join_rows
from avrare.logic.semantics.terms import align, compile_term
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.semantics.window_operators import (
    Array,
    accumulate,
    fold_until,
    get_dual,
    get_neutral,
    slide,
)
from avrare.logic.syntax import nodes

FEW = 16
"""Open values up to which monitors without corners compute them one by one, each from the next."""


class ComparisonNode(MonitorNode):
    """Comparison of two terms."""

    def __init__(self, formula: nodes.Comparison) -> None:
        super().__init__()
        self.formula = formula
        self._left, self._right = compile_term(formula.left, 1), compile_term(formula.right, 1)

    def value(self, now: SampleContext, i: int) -> Array:
        """Return the value at the newest sample."""
        left, right = self._left(now.sample), self._right(now.sample)
        if type(right) is not float:
            left, right = align(left, right)
        value = now.algebra.compare(self.formula, left, right)
        if not isinstance(value, np.ndarray):
            value = np.full(now.rows, value)
        return value.reshape((1,) * now.n + value.shape) if now.n else value  # type: ignore[no-any-return]

    def open(self, samples: OpenSamples) -> Array:
        """Return the comparison's range."""
        newest = samples.now.tables[self.index][-1]
        return samples.fill(samples.exact.unseen(self.formula), newest.shape[samples.now.n + 1 :])


class PointwiseNode(MonitorNode):
    """Operator without time: not, and, or, iff, xor or a quantifier.

    Args:
        apply: Function of the operands' values at the same samples, of their algebra, and of the number of
            axes before those of vehicles.
        children: Operands.
    """

    def __init__(
        self, apply: Callable[[list[Array], RobustnessAlgebra, int], Array], children: Sequence[MonitorNode]
    ) -> None:
        super().__init__(children)
        self._apply = apply

    def value(self, now: SampleContext, i: int) -> Array:
        """Apply the operator at one sample."""
        return self._apply([now.at(child, i) for child in self.children], now.algebra, now.n + 1)

    def open(self, samples: OpenSamples) -> Array:
        """Apply the operator at all open samples."""
        operands = [samples.rows(child, samples.start(self)) for child in self.children]
        return self._apply(operands, samples.algebra, samples.lead)


class _TemporalNode(MonitorNode):
    """Operator whose witnesses are joined by ``join``, ``lo`` to ``hi`` samples away."""

    def __init__(
        self,
        join: np.ufunc,
        children: Sequence[MonitorNode],
        bounds: tuple[int, int] = (0, 0),
        *,
        past: bool = False,
        closed: bool = True,
    ) -> None:
        self.lo, self.hi = bounds
        super().__init__(children, ahead=0 if past else self.hi, behind=self.hi if past else 0)
        self.join, self.closed = join, closed

    def _operand_rows(self, samples: OpenSamples, behind: int = 0) -> tuple[Array, Array]:
        start = max(0, samples.start(self) - behind)
        return broadcast(*(samples.rows(child, start) for child in self.children))

    def _expand(self, left: Array, right: Array, later: Array | None) -> Array:
        # Expansion law: until from its value at the next sample, since from that at the previous one.
        join, meet = self.join, get_dual(self.join)
        if later is None:
            left, right = broadcast(left, right)
            return np.asarray(meet(left, right)) if self.closed else right
        if not left.shape == right.shape == later.shape:
            right, later = align(right, later)
            left, right = align(left, right)
            left, later = align(left, later)
        return np.asarray(meet(left, join(right, later)) if self.closed else join(right, meet(left, later)))

    def _fold_operands(self, now: SampleContext, i: int, samples: Sequence[int]) -> Array:
        # The samples are the operands', farthest first.
        left, right = self.children
        value = None
        for k in samples:
            if abs(k - i) >= self.lo:
                value = self._expand(now.at(left, k), now.at(right, k), value)
            elif value is not None:
                value = np.asarray(get_dual(self.join)(*align(now.at(left, k), value)))
        if value is None:
            like, _ = broadcast(now.at(left, i), now.at(right, i))
            return np.full_like(like, get_neutral(self.join))
        return value


class PairNode(MonitorNode):
    """Join of the operand's values at two samples, ``near`` and ``far`` ones ahead (behind if negative)."""

    def __init__(self, join: np.ufunc, child: MonitorNode, near: int, far: int) -> None:
        super().__init__([child], ahead=max(0, far), behind=max(0, -far))
        self.join, self.near, self.far = join, near, far
        self._child = child
        newest = self.delay - child.delay + 1
        self._rows = near - newest, far - newest
        self._first = self.delay - min(0, near, far) if near != far else math.inf

    def settle(self, now: SampleContext) -> Array:
        """Join both values from the operand's table, as soon as that goes back far enough."""
        if now.t < self._first:
            return self.value(now, now.t - self.delay)
        near, far = self._rows
        settled = now.tables[self._child.index]
        return self.join(settled[near], settled[far])  # type: ignore[no-any-return]

    def value(self, now: SampleContext, i: int) -> Array:
        """Join the values inside the trace; neutral if there are none."""
        near, far, child = i + self.near, i + self.far, self._child
        if 0 <= far <= now.t:
            x = now.at(child, far)
            return x if near == far else self.join(now.at(child, near), x)
        if 0 <= near <= now.t:
            return now.at(child, near)
        return np.full_like(now.at(child, i), get_neutral(self.join))


class WindowNode(PairNode):
    """Bounded always, eventually, historically or once: the end of a chain of pairs.

    Args:
        pair: Last pair of the chain.
        base: Operand, whose samples ``lo`` to ``hi`` away are joined.
        lo: First sample of the window.
        hi: Last sample of the window.
    """

    def __init__(self, pair: PairNode, base: MonitorNode, lo: int, hi: int) -> None:
        super().__init__(pair.join, pair.children[0], pair.near, pair.far)
        self.base, self.lo, self.hi, self.past = base, lo, hi, pair.far < 0
        self._few = 0 if self.past or lo else min(hi, FEW)
        base.keep = max(base.keep, hi)

    def value(self, now: SampleContext, i: int) -> Array:
        """Join the pair; where windows are clipped, extend the next sample's value."""
        if i <= now.t - self._few:
            return PairNode.value(self, now, i)
        x = now.at(self.base, i)
        return x if i == now.t else self.join(x, now.at(self, i + 1))

    def open(self, samples: OpenSamples) -> Array:
        """Slide the clipped window."""
        start, count = samples.start(self), samples.count(self)
        if self.past:
            first = max(0, start - self.hi)
            x = samples.rows(self.base, first)
            return slide(x[::-1], self.lo, self.hi, self.join)[::-1][start - first :]
        x = samples.ahead(samples.rows(self.base, start), self.hi)
        return slide(x, self.lo, self.hi, self.join)[:count]


def make_window(join: np.ufunc, lo: int, hi: int, base: MonitorNode, past: bool) -> list[MonitorNode]:
    """Make the chain of nodes that ends with a bounded window, doubling its width from pair to pair."""
    sign, width, covered = -1 if past else 1, hi - lo + 1, 1
    chain: list[MonitorNode] = [base]
    while len(chain) == 1 or covered < width:
        by = min(covered, width - covered)
        offset = lo if covered + by == width else 0  # only the last pair has the window's offset
        pair = PairNode(join, chain[-1], sign * offset, sign * (offset + by))
        chain.append(pair)
        covered += by
    return [*chain[1:-1], WindowNode(pair, base, lo, hi)]


class UnboundedPastNode(_TemporalNode):
    """once and historically over the entire past."""

    def value(self, now: SampleContext, i: int) -> Array:
        """Join the previous value and the operand."""
        before, value = now.before(self, i), now.at(self.children[0], i)
        return value if before is None else np.asarray(self.join(before, value))

    def open(self, samples: OpenSamples) -> Array:
        """Accumulate the operand's open values onto the settled value."""
        x = samples.open(self.children[0])
        settled = samples.settled(self, 1)
        if settled is None or not len(x):
            return accumulate(self.join, x)
        return accumulate(self.join, join_rows(settled, x))[1:]


class SinceNode(_TemporalNode):
    """Bounded since and trigger."""

    def value(self, now: SampleContext, i: int) -> Array:
        """Fold the operands' values, oldest first."""
        return self._fold_operands(now, i, range(max(0, i - self.hi), i + 1))

    def open(self, samples: OpenSamples) -> Array:
        """Fold the operands' values, settled and open, as until backwards."""
        left, right = self._operand_rows(samples, self.hi)
        values = fold_until(left[::-1], right[::-1], self.lo, self.hi, self.closed, self.join)[::-1]
        return values[len(values) - samples.count(self) :]


class UnboundedSinceNode(_TemporalNode):
    """since and trigger over the entire past."""

    def value(self, now: SampleContext, i: int) -> Array:
        """Expand from the previous value."""
        left, right = (now.at(child, i) for child in self.children)
        return self._expand(left, right, now.before(self, i))

    def open(self, samples: OpenSamples) -> Array:
        """Expand from the settled value on."""
        left, right = self._operand_rows(samples)
        settled = samples.settled(self, 1)
        value = None if settled is None else settled[-1]
        values = []
        for l, r in zip(left, right, strict=True):
            value = self._expand(l, r, value)
            values.append(value)
        return np.stack(values) if values else left


class UntilNode(_TemporalNode):
    """Bounded until and release."""

    def value(self, now: SampleContext, i: int) -> Array:
        """Fold the operands' values, newest first; where windows are clipped, expand the next value."""
        if not self.lo and i < now.t <= i + self.hi:
            left, right = self.children
            for k in range(now.t if i + self.hi == now.t else i + 1, i, -1):  # keeps the recursion shallow
                later = now.at(self, k)
            return self._expand(now.at(left, i), now.at(right, i), later)
        return self._fold_operands(now, i, range(min(i + self.hi, now.t), i - 1, -1))

    def open(self, samples: OpenSamples) -> Array:
        """Fold the clipped window."""
        left, right = (samples.ahead(x, self.hi) for x in self._operand_rows(samples))
        return fold_until(left, right, self.lo, self.hi, self.closed, self.join)[: samples.count(self)]


class ObligationNode(_TemporalNode):
    """Unbounded future operator: always and eventually with one operand, until and release with two."""

    def bind(self, axis: int, count: int) -> None:
        """Set the corner axis of this obligation, one of ``count``."""
        self.obligation = axis
        self.depends |= {axis}
        self._corner = corner(axis, count)

    def value(self, now: SampleContext, i: int) -> Array:
        """Expand from the value at the next sample, which is the corner."""
        operands = [now.at(child, i) for child in self.children]
        if len(operands) == 1:
            return np.asarray(self.join(*align(operands[0], self._corner)))
        later = self._corner.reshape(self._corner.shape + (1,) * (operands[1].ndim - self._corner.ndim))
        return self._expand(operands[0], operands[1], later)

    def open(self, samples: OpenSamples) -> Array:
        """Fold to the end of the trace."""
        if len(self.children) == 1:
            return slide(samples.open(self.children[0]), 0, np.inf, self.join)
        left, right = self._operand_rows(samples)
        return fold_until(left, right, 0, np.inf, self.closed, self.join) if len(left) else left
