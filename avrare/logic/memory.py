"""Unbounded past operators whose value is carried from sample to sample.

``once φ`` needs no history: it is the larger of its last value and φ now. An offset is split off,
``once[a,inf] φ`` = ``once[a,a] (once φ)``, and needs a history of only ``a`` samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.robustness import Evaluator, align

Array = NDArray[Any]


@dataclass(frozen=True)
class Memory:
    """once, historically or since, over the whole past.

    Attributes:
        op: The operator.
        left: Left operand of since.
        right: The operand.
        index: Its slot in the formulas above it.
    """

    op: str
    left: f.Node | None
    right: f.Node
    index: int

    @property
    def window(self) -> float:
        """How many of the newest samples it reads."""
        return 1 + max(f.history(node) for node in (self.left, self.right) if node)

    def step(self, evaluate: Evaluator, before: Array | None) -> Array:
        """The value (N, ...) now.

        Args:
            evaluate: Evaluator whose last sample is now.
            before: The value at the last sample; None at the first.
        """
        now = evaluate(self.right)[-1:]
        if self.left is None:
            join, _ = evaluate.reduction(self.op)
            return np.asarray(now[0].copy() if before is None else join(before, now[0]))
        left, now = (x[0] for x in align(evaluate(self.left)[-1:], now))
        new = np.minimum(left, now) if evaluate.closed else np.broadcast_arrays(now, left)[0].copy()
        return new if before is None else np.maximum(new, np.minimum(left, before))


def remember(node: f.Node, found: list[Memory]) -> f.Node:
    """The formula with its unbounded past operators replaced by slots.

    Args:
        node: The formula.
        found: Memories so far, in the order in which they must be updated; extended.
    """
    node = f.rebuild(node, lambda child: remember(child, found))
    match node:
        case f.Window("once" | "historically" as op, lo, math.inf, child) if f.horizon(child) == 0:
            return _delayed(op, lo, _slot(op, None, child, found))
        case f.Until("since", lo, math.inf, left, right) if f.horizon(left) == f.horizon(right) == 0:
            slot = _slot("since", left, right, found)
            if lo == 0:
                return slot
            kept = f.Window("historically", 0, lo - 1, left)
            return f.Connective("and", kept, _delayed("once", lo, slot))
        case _:
            return node


def _delayed(op: str, lo: int, slot: f.Node) -> f.Node:
    return slot if lo == 0 else f.Window(op, lo, lo, slot)


def _slot(op: str, left: f.Node | None, right: f.Node, found: list[Memory]) -> f.Slot:
    for memory in found:
        if (memory.op, memory.left, memory.right) == (op, left, right):
            return f.Slot(memory.index)
    memory = Memory(op, left, right, len(found))
    found.append(memory)
    return f.Slot(memory.index)
