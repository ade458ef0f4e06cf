"""Root folds: the parts of a formula's value at sample 0 that change as samples arrive.

A fold joins the settled values of its nodes, sample by sample, into its carry of tables (corners, N, ...).
Its present value joins the open ones too; with corners or bounds all at once. Connectives and quantifiers
above the folds are then applied to one value each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from avrare.logic.monitor.corner_tables import compose
from avrare.logic.monitor.monitor_node import MonitorNode, OpenSamples, SampleContext, broadcast, join_rows
from avrare.logic.semantics.terms import align
from avrare.logic.semantics.trace_evaluator import Evaluator
from avrare.logic.semantics.value_algebra import IntervalAlgebra, RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, accumulate, get_dual, get_neutral
from avrare.logic.syntax.nodes import Node, settling, signals

FoldCarry = tuple[Array, ...]


class RootFold:
    """Sub-formula at sample 0.

    Args:
        node: Node whose settled values are folded; None for a fold without nodes.

    Attributes:
        delay: Samples until a value is settled.
        shrinking: True if one or two of the open values determine the result.
    """

    shrinking = False

    def __init__(self, node: MonitorNode | None = None) -> None:
        self.node = node
        self.delay = node.delay if node else 0
        self._depends = bool(node and node.depends)

    def settle(self, now: SampleContext, carry: FoldCarry) -> FoldCarry:
        """Return the carry after one more sample; empty before anything is settled."""
        if self._depends:
            carry = tuple(compose(x, now.values, 0) for x in carry)
        i = now.t - self.delay
        return self.step(now, carry, i) if i >= 0 else carry

    def open_samples(self, t: int) -> Sequence[int]:
        """Return the open samples up to ``t`` that matter."""
        return range(max(0, t - self.delay + 1), t + 1)

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        """Return the carry with sample ``i`` folded in."""
        raise NotImplementedError

    def result(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the value (N, ...) of all samples carried, without corners."""
        return carry[-1]

    def nominal(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the nominal value (N, ...), without corners."""
        for i in self.open_samples(now.t) if self.delay else ():
            carry = self.step(now, carry, i)
        return self.result(now, carry)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        """Return the value, (N, ...) or as bounds (2, N, ...)."""
        raise NotImplementedError


class WindowFold(RootFold):
    """always or eventually: running extremum of the settled values, joined with the open ones.

    Args:
        join: ``np.minimum`` or ``np.maximum``.
        lo: First sample of the window.
        hi: Last sample of the window; may be infinite.
        node: Operand.
        shrinking: True if the open values are extrema of the other kind, each over a later part of the
            samples of the one before, and the first over a part of those of the last settled one. The last
            one then decides; as long as nothing is settled, the first one is needed to find NaN.
    """

    node: MonitorNode

    def __init__(
        self, join: np.ufunc, lo: int, hi: float, node: MonitorNode, shrinking: bool = False
    ) -> None:
        super().__init__(node)
        self.join, self.lo, self.hi, self.shrinking = join, lo, hi, shrinking

    def open_samples(self, t: int) -> Sequence[int]:
        """Return the open samples of the window that matter."""
        settled = t - self.delay
        samples = range(max(self.lo, settled + 1), int(min(self.hi, t)) + 1)
        if not self.shrinking or len(samples) < 2:
            return samples
        return samples[-1:] if settled >= self.lo else samples[:: len(samples) - 1]

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        """Fold one more value."""
        if not self.lo <= i <= self.hi:
            return carry
        value = now.at(self.node, i)
        return (self.join(carry[0], value),) if carry else (value,)

    def result(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the extremum; neutral before the window."""
        return carry[0] if carry else np.full_like(now.at(self.node, now.t), get_neutral(self.join))

    def nominal(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the extremum; of shrinking values only the newest is needed."""
        if self.shrinking and carry and now.t <= self.hi:
            return self.join(carry[0], self.node.value(now, now.t))  # type: ignore[no-any-return]
        return super().nominal(now, carry)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        """Fold all samples of the window."""
        folded = None if not carry else samples.collapse(carry[0], self.node)
        x: Any = ()
        if samples.count(self.node):
            x, start = samples.open(self.node), samples.start(self.node)
            if start < self.lo or self.hi < samples.end:
                x = x[samples.within(start, self.lo, self.hi)]
        if not len(x):
            return samples.like(self.node, get_neutral(self.join)) if folded is None else folded
        rest = np.asarray(x[0] if len(x) == 1 else self.join.reduce(x, axis=0))
        return rest if folded is None else np.asarray(self.join(*align(folded, rest)))


class UntilFold(RootFold):
    """until: margin by which the left operand has held, and the best witness; dually release."""

    node: MonitorNode

    def __init__(
        self, join: np.ufunc, lo: int, hi: float, operands: tuple[MonitorNode, MonitorNode], closed: bool
    ) -> None:
        super().__init__(MonitorNode(operands))
        self.join, self.lo, self.hi, self.closed = join, lo, hi, closed
        self.left, self.right = operands

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        """Fold one more possible witness."""
        if i > self.hi:
            return carry
        left, right = broadcast(now.at(self.left, i), now.at(self.right, i))
        join, meet = self.join, get_dual(self.join)
        before, best = carry or (np.full_like(left, get_neutral(meet)), np.full_like(left, get_neutral(join)))
        held = meet(before, left)
        if i >= self.lo:
            best = join(best, meet(right, held if self.closed else before))
        return held, best

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        """Return the best of the settled witnesses and the open ones."""
        # 1. The settled witnesses.
        before, best = (None, None) if not carry else (samples.collapse(x, self.node) for x in carry)
        if best is not None and not samples.count(self.node):
            return best
        # 2. The margin by which the left operand has held before each open sample.
        first, meet = samples.start(self.node), get_dual(self.join)
        left, right = broadcast(samples.rows(self.left, first), samples.rows(self.right, first))
        if before is None:
            before = np.full_like(left[0], get_neutral(meet))
        held = accumulate(meet, join_rows(before[None], left))
        # 3. The open witnesses inside the window.
        allowed = samples.within(first, self.lo, self.hi)
        witnesses = meet(right[allowed], self._held_until_witness(samples, held)[allowed])
        found = np.asarray(self.join.reduce(witnesses, axis=0, initial=get_neutral(self.join)))
        return found if best is None else np.asarray(self.join(best, found))

    def _held_until_witness(self, samples: OpenSamples, held: Array) -> Array:
        # The left operand's margin before each row's first sample in the window; including it if closed.
        if self.closed:
            return held[1:]
        common = samples.common_row(self.lo)
        if common is not None:  # the earlier samples of this row need the left operand too
            row = common - samples.start(self.node)
            held[row] = held[row + 1]
        return held[:-1]


class HistoryFold(RootFold):
    """Any other formula: carries all samples and evaluates it on them at every sample."""

    def __init__(self, formula: Node, closed: bool) -> None:
        super().__init__()
        self.formula, self.closed = formula, closed
        self.names = signals(formula)

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        """Append the sample."""
        newest = [now.sample[name][:, None] for name in self.names]
        newest = [x.reshape((1,) * now.n + x.shape) for x in newest]
        if not carry:
            return tuple(x.copy() for x in newest)
        return tuple(np.concatenate(pair, axis=now.n + 1) for pair in zip(carry, newest, strict=True))

    def result(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Evaluate all samples."""
        return self._evaluate(now, carry, now.algebra)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        """Evaluate all samples."""
        now, unseen, algebra = samples.now, samples.unseen, samples.exact
        if samples.bounded:
            grid = unseen.length or now.t + 2 + settling(self.formula)
            algebra = IntervalAlgebra(samples.exact, grid, endless=unseen.length is None)
        return self._evaluate(now, carry, algebra)

    def _evaluate(self, now: SampleContext, carry: FoldCarry, algebra: RobustnessAlgebra) -> Array:
        arrays = [np.moveaxis(x.reshape(x.shape[now.n :]), 1, 0) for x in carry]
        samples = dict(zip(self.names, arrays, strict=True))
        evaluate = Evaluator(samples, now.t + 1, now.rows, algebra, self.closed)
        return np.asarray(evaluate(self.formula)[0])
