"""Values of monitor nodes at samples that no settled value covers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.logic.monitor.monitor_nodes import MonitorNode, PastNode, SampleContext, UntilNode, collapse
from avrare.logic.semantics.trace_evaluator import operate
from avrare.logic.semantics.value_algebra import IntervalAlgebra
from avrare.logic.semantics.window_operators import Array, get_neutral
from avrare.logic.syntax import nodes


@dataclass(frozen=True)
class UnseenSamples:
    """Samples not seen yet, as rows of an array.

    Attributes:
        count: Number of rows.
        common: Row that represents all samples between the first ones, which come before, and the last ones.
        skipped: Samples without a row of their own; infinite in an endless trace.
    """

    count: int = 0
    common: int = 0
    skipped: float = 0

    @staticmethod
    def of(seen: int, settling: int, reach: int, length: int | None) -> UnseenSamples:
        """Lay out the samples after ``seen`` ones of a trace of ``length`` samples (None: endless).

        Values are constant from ``settling`` samples after the last one seen to ``reach`` samples before the
        end.
        """
        if length is None:
            return UnseenSamples(settling + 1, settling, math.inf)
        count = min(length - seen, settling + 1 + reach)
        return UnseenSamples(count, settling, length - seen - count)

    def find_row(self, sample: float) -> float:
        """Return the row of a sample, counted from the first one not seen."""
        return sample if sample <= self.common else max(self.common, sample - self.skipped)


class OpenSamples:
    """Values of nodes at the samples after their settled ones: (P, N, ...), or (P, 2, N, ...) as bounds.

    Args:
        now: Newest sample, all nodes settled.
        obligations: Nodes with a corner axis, in this order.
        unseen: Samples not seen yet; None gives nominal values, of the trace as it is.
    """

    def __init__(
        self, now: SampleContext, obligations: Sequence[MonitorNode], unseen: UnseenSamples | None
    ) -> None:
        self._now, self._obligations, self._bounded = now, obligations, unseen is not None
        self._unseen = unseen or UnseenSamples()
        self.algebra = now.algebra
        if self._bounded:
            self.algebra = IntervalAlgebra(now.algebra, endless=math.isinf(self._unseen.skipped))
        self._last = now.t + self._unseen.count  # counting rows as samples
        self._values: dict[int, Array] = {}

    def count(self, node: MonitorNode) -> int:
        """Return the number of open samples of the node."""
        return self._last - self._start(node) + 1

    def reduce(self, node: MonitorNode, join: np.ufunc, lo: int, hi: float) -> Array:
        """Join the node's open values at the samples ``lo .. hi``."""
        first, after = self._start(node), self._now.t + 1
        begin, end = (after + self._unseen.find_row(sample - after) for sample in (lo, hi))
        inside = slice(max(0, int(begin) - first), max(0, int(min(end, self._last)) + 1 - first))
        return np.asarray(join.reduce(self._open(node)[inside], axis=0, initial=get_neutral(join)))

    def collapse(self, table: Array) -> Array:
        """Evaluate a table (corners, N, ...) at the first open values of the obligations."""
        if self._bounded:
            n = len(self._obligations)
            table = table.reshape(*table.shape[:n], 1, *table.shape[n:])
        lengths = zip(table.shape, self._obligations, strict=False)
        values = [self._first_open(node) if length > 1 else None for length, node in lengths]
        return collapse(table, values, self.algebra.lead - 1)

    def _start(self, node: MonitorNode) -> int:
        return max(0, self._now.t - node.delay + 1)

    def _open(self, node: MonitorNode) -> Array:
        if node.index not in self._values:
            self._values[node.index] = self._evaluate(node)
        return self._values[node.index]

    def _evaluate(self, node: MonitorNode) -> Array:
        start = self._start(node)
        if isinstance(node.formula, nodes.Comparison):
            return self._fill(node.formula, self._now.tables[node.index][-1])
        operands = [self._rows(operand, max(0, start - node.behind)) for operand in node.operands]
        settled = self._now.tables[node.index]
        if isinstance(node, PastNode) and settled:
            last = self.collapse(settled[-1])[None]
            operands = [_join_rows(last, operand) for operand in operands]
        value = operate(node.formula, operands, self.algebra, self._now.closed, self.algebra.lead)
        return value[len(value) - self.count(node) :]

    def _rows(self, node: MonitorNode, first: int) -> Array:
        # The values from sample ``first`` on.
        start = self._start(node)
        if first >= start:
            return self._open(node)[first - start :]
        settled = [self.collapse(table) for table in self._now.tables[node.index][first - start :]]
        same = len({table.shape for table in settled}) == 1
        rows = np.array(settled if same else np.broadcast_arrays(*settled))
        return _join_rows(rows, self._open(node)) if self.count(node) else rows

    def _fill(self, formula: nodes.Comparison, newest: Array) -> Array:
        # All unseen samples may have any value.
        trailing = newest.shape[len(self._obligations) + 1 :]
        values = np.empty((self._unseen.count, *((2, 1) if self._bounded else (1,)), *trailing))
        if self._bounded:
            values[:, 0], values[:, 1] = self._now.algebra.bound_unseen_samples(formula)
        return values

    def _first_open(self, node: MonitorNode) -> Array:
        if self.count(node):
            return np.asarray(self._open(node)[0])
        assert isinstance(node, UntilNode)
        return np.full((2, 1) if self._bounded else 1, get_neutral(node.join))


def _join_rows(settled: Array, rows: Array) -> Array:
    # They may differ in axes that broadcast.
    ndim = max(settled.ndim, rows.ndim)
    settled, rows = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (settled, rows))
    shape = np.broadcast_shapes(settled.shape[1:], rows.shape[1:])
    return np.concatenate([np.broadcast_to(x, (len(x), *shape)) for x in (settled, rows)])
